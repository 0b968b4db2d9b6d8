"""Session of force feedback: its request, its state and its failure. Pure."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from forcemesh.bus import Reading
from forcemesh.messages import ArbiterStatus, Gains, StartLaw
from forcemesh.requests import ForceStartRequest, PathRequest
from services.regulator.adaptive import AdaptiveState
from services.regulator.admittance import AdmittanceState
from services.regulator.guards import Flags, GuardSample, GuardState
from services.regulator.law import LawInput, LawState
from services.regulator.link_lag import CommandHistory
from services.regulator.tcp_path import TcpPath, advance, append_points, remaining_m
from services.regulator.unverified_axes import ToolMotion

MOVERS = ("operator", "program")  # commanders that suspend the regulator


class Failure(NamedTuple):
    """Cause of a latched failure: a code of forcemesh/faults.py and a text."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class ForceSession:
    """Force feedback from its start to its stop."""

    request: ForceStartRequest
    setpoint_N: float  # ramped
    law: LawState
    last_sample_ns: int
    lease: int  # under which it was started
    watch: GuardState
    gains: Gains  # ramped
    adaptive: AdaptiveState | None = None  # state of the adaptive law, if it runs
    guide: AdmittanceState | None = None  # state of hand guiding, if it runs
    path: TcpPath | None = None  # path across the tool's axis, if there is one
    sent: Gains | None = None  # gains sent to the controller, from the estimated stiffness
    report: tuple[int, int] | None = None  # the robot's last one: epoch and number
    T_measured: pin.SE3 | None = None  # of the TCP, at the last sample
    commanded: CommandHistory | None = None  # recent commands, with the PC as host
    failure: Failure | None = None  # latched: an input failed, or a monitor tripped


def first_setpoint_N(force_N: Array, T_base_tcp: pin.SE3, target_N: float) -> float:
    """Return the initial value of the set-point ramp: the measured press, at most the target.

    An arm that already presses does not release first, and a release does not wait for a ramp.

    Args:
        force_N: Force of the environment on the tool, base axes, shape (3,) [N].
        T_base_tcp: Measured pose of the TCP in base.
        target_N: Target press along the tool's z axis [N].
    """
    measured_N = -float(np.dot(force_N, T_base_tcp.rotation[:, 2]))
    return min(max(measured_N, 0.0), target_N)


def describe(request: ForceStartRequest, law: StartLaw) -> str:
    """Return a text of what was started, including defaults from the cell file."""
    preset = f" with preset {request.preset}" if request.preset else ""
    host = "the PC" if request.host == "pc" else "the controller"
    return (
        f"force feedback is on: mode {request.mode}, set point {request.setpoint_N:g} N, "
        f"law {law}{preset}, on {host}"
    )


def active_commander(arbiter: ArbiterStatus) -> str:
    """Return the commander that moves the arm or is next, empty if only the regulator may."""
    both = (arbiter.commander, arbiter.next_commander)
    return next((commander for commander in both if commander in MOVERS), "")


def guard_sample(
    law: LawState,
    sample: LawInput,
    T_base_tcp: pin.SE3,
    adaptive: AdaptiveState | None,
    *,
    motion: ToolMotion,
    limited: Flags,
) -> GuardSample:
    """Return the monitors' view of one sample; mode orientation has no approach."""
    error_N = _free(law.error_force_N, sample, 0)
    error_Nm = _free(law.error_torque_Nm, sample, 3)
    moves, rotates = sample.mode != "orientation", sample.mode != "position"
    return GuardSample(
        force_N=sample.force_N,
        torque_Nm=sample.torque_Nm,
        T_base_tcp=T_base_tcp,
        contact=law.contact if moves else "free",
        error=np.concatenate((error_N * moves, error_Nm * rotates)),
        rotates=rotates,
        dt_s=sample.dt_s,
        follows=adaptive is not None and adaptive.tracking.near,
        presses=moves and sample.setpoint_N > 0.0,
        motion=motion,
        limited=limited,
        setpoint_N=sample.setpoint_N,
    )


def _free(error: Array | None, sample: LawInput, first: int) -> Array:
    """Return the part of an error along the free axes, the only ones that the loop controls."""
    if error is None:
        return np.zeros(3)
    R = np.eye(3) if sample.R_base_task is None else sample.R_base_task
    return np.asarray(R @ (np.array(sample.axes[first : first + 3]) * (R.T @ error)))


def failure_of(reading: Reading[Any]) -> Failure | None:
    """Return the failure of an input, None while it is usable."""
    return Failure(reading.code, reading.fault) if reading.fault else None


def next_path(session: ForceSession, request: PathRequest) -> TcpPath:
    """Return the path that a session follows from now on."""
    ahead = session.path if request.append else None
    path = append_points(
        ahead,
        tuple(np.array(point) for point in request.points_m),
        speed_m_s=request.speed_m_s,
        accel_m_s2=request.accel_m_s2,
        in_contact=request.in_contact,
    )
    return replace(path, now_m_s=session.path.now_m_s if session.path else 0.0)


def apply_path(
    before: LawState, law: LawState, path: TcpPath | None, *, dt_s: float, speed_max_m_s: float
) -> tuple[LawState, TcpPath | None]:
    """Return the state after one period of path motion, and the rest of the path.

    Force control and path together keep the regulator's speed limit.
    """
    if path is None:
        return law, None
    if path.in_contact and law.contact != "contact":
        return law, replace(path, now_m_s=0.0)
    T = law.T_base_tcp
    path, shift_m = advance(
        path,
        T.translation,
        T.rotation[:, 2],
        dt_s=dt_s,
        pushed_m=T.translation - before.T_base_tcp.translation,
        most_m=speed_max_m_s * dt_s,
    )
    return replace(law, T_base_tcp=pin.SE3(T.rotation, T.translation + shift_m)), path


def remaining_path_m(session: ForceSession) -> float | None:
    """Return the path length to the last point [m], None without a path."""
    if session.path is None:
        return None
    T = session.law.T_base_tcp
    return remaining_m(session.path, T.translation, T.rotation[:, 2])
