"""Control step of the selected law, gain ramps, and the stiffness kept between sessions. Pure."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import vec3
from common.motion.frames import Array, rotation_between
from forcemesh.messages import Gains, WrenchAtTcp
from forcemesh.requests import ForceStartRequest
from services.regulator import adaptive
from services.regulator.adaptive import AdaptiveSettings, AdaptiveState
from services.regulator.law import LawInput, LawSettings, LawState, PiGains, step
from services.regulator.settings import law_settings, pi_gains

VALID_WITHIN_M, VALID_WITHIN_RAD = 0.002, 0.05  # an identified stiffness is valid this close by
GAIN_RAMP_S = 0.1  # time constant
SAME_GAIN = 0.15  # relative change of the controller's gains below which no command is sent


@dataclass(frozen=True, slots=True)
class LawTools:
    """Settings of both laws."""

    plain: LawSettings
    adaptive: AdaptiveSettings

    @classmethod
    def of(cls, cell: CellConfig) -> "LawTools":
        """Return the settings of a cell."""
        return cls(law_settings(cell), AdaptiveSettings.of(cell))


@dataclass(frozen=True, slots=True)
class ContactStiffness:
    """Contact stiffness identified last, with its pose: valid after a stop and a start in place."""

    k: Array  # shape (3,), tool axes
    T_base_tcp: pin.SE3

    def at_pose(self, T_base_tcp: pin.SE3) -> Array | None:
        """Return the stiffness if it is valid at a pose, None elsewhere."""
        distance_m = np.linalg.norm(T_base_tcp.translation - self.T_base_tcp.translation)
        turn_rad = rotation_between(self.T_base_tcp.rotation, T_base_tcp.rotation)
        if distance_m > VALID_WITHIN_M or np.linalg.norm(turn_rad) > VALID_WITHIN_RAD:
            return None
        return self.k


def last_identified(adaptive_state: AdaptiveState | None) -> ContactStiffness | None:
    """Return the stiffness that a session identified; None out of contact or if it did not."""
    if (
        adaptive_state is None
        or adaptive_state.free_s > 0.0
        or not adaptive_state.stiffness.identified[2]
    ):
        return None
    return ContactStiffness(adaptive_state.stiffness.k, adaptive_state.measured.travel.T_base_tcp)


def reset_predictor(
    adaptive_state: AdaptiveState | None, law: LawState, T_measured: pin.SE3, tools: LawTools
) -> AdaptiveState | None:
    """Return a reset state: the commands were not sent, so the predicted force does not occur."""
    if adaptive_state is None:
        return None
    return adaptive.begin(law.T_base_tcp, T_measured, tools.adaptive)


def still_valid(
    before: ContactStiffness | None, wrench: WrenchAtTcp | None, tools: LawTools
) -> ContactStiffness | None:
    """Return the identified stiffness while no force feedback runs, None once contact is lost."""
    if before is None or wrench is None:
        return None
    return before if np.linalg.norm(wrench.force_N) > tools.adaptive.touch_N else None


def task_frame(request: ForceStartRequest, R_base_tcp: Array) -> Array:
    """Return the task frame in which a request frees or locks axes. Shape (3, 3)."""
    return R_base_tcp if request.frame == "tool" else np.eye(3)


def control(
    law: LawState,
    adaptive_state: AdaptiveState | None,
    sample: LawInput,
    T_measured: pin.SE3,
    *,
    gains: PiGains,
    tools: LawTools,
) -> tuple[LawState, AdaptiveState | None]:
    """Return the next states; without an adaptive state the plain law runs."""
    if adaptive_state is None:
        return step(law, sample, gains, tools.plain), None
    return adaptive.advance(
        law,
        adaptive_state,
        sample,
        T_measured,
        gains=gains,
        plain=tools.plain,
        settings=tools.adaptive,
    )


def ramped(now: Gains, goal: Gains, dt_s: float) -> Gains:
    """Return gains one period further towards a goal (first-order low-pass)."""
    if now == goal:
        return goal
    share = min(1.0, dt_s / GAIN_RAMP_S)
    before, after = now.as_dict(), goal.as_dict()
    return Gains(
        **{
            name: tuple(
                b if abs(b - a) <= 1e-3 * abs(b) else a + share * (b - a)
                for a, b in zip(before[name], after[name], strict=True)
            )
            for name in after
        }
    )


def controller_gains(
    sent: Gains | None,
    requested: Gains,
    R_base_tcp: Array,
    *,
    adaptive_state: AdaptiveState,
    tools: LawTools,
) -> Gains:
    """Return the gains for force feedback in the controller, from the estimated stiffness.

    The controller has no predictor, so the plain gain rule applies. Small changes are not sent.
    R_base_tcp has shape (3, 3).
    """
    share = adaptive.requested_gain_share(pi_gains(requested), R_base_tcp, tools.adaptive)
    target = (R_base_tcp * R_base_tcp) @ (
        share * adaptive.plain_gain(adaptive_state, tools.adaptive)
    )
    if sent is not None:
        now = np.array(sent.force_i_m_per_Ns)
        if bool((np.abs(target - now) <= SAME_GAIN * now).all()):
            return sent
    return requested.replaced(force_i_m_per_Ns=vec3(target))
