"""Delay model of the Smith predictor: between command and filtered force. Pure.

    command -> dead time -> lag/2 -> lag/2 -> filter -> travel that the present force belongs to

Dead time covers controller, processes and the median filter; two first-order lags model the servo,
a third the low-pass of the wrench filter. The half period between two commands needs no term: a
command holds until the next one (zero-order hold). `adaptive.py` predicts the force with it.

`ContactTravel` passes the travel of the contact point through the model. A rotation about the TCP
moves that point too. Travel is accumulated along the tool axes of each period, so that a later
rotation does not turn travel across the tool axis into travel along it.
"""

from dataclasses import dataclass
from math import ceil, exp

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array
from services.regulator.law import LawMotion, motion_between

INSTANT_S = 1e-5  # a shorter lag counts as zero
SUBSTEP_S = 0.001  # three lags in series are accurate enough in steps of a millisecond


@dataclass(frozen=True, slots=True)
class DelayModelSettings:
    """Parameters of the delay model."""

    delay_s: float  # controller, processes, and the median of the wrench filter
    lag_s: float
    filter_s: float

    @classmethod
    def of(cls, cell: CellConfig) -> "DelayModelSettings":
        """Return the parameters of a cell; with half a period their sum is tau."""
        wrench = cls.of_wrench(cell)
        delay_s = cell.robot.delay_s + cell.force.chain_s + wrench.delay_s
        return cls(delay_s, cell.robot.lag_s, wrench.filter_s)

    @classmethod
    def of_wrench(cls, cell: CellConfig) -> "DelayModelSettings":
        """Return those of the wrench filter alone: from the measured pose to the filtered force."""
        lowpass_s = cell.filter.lowpass_s
        return cls(cell.filter_delay_s - lowpass_s, 0.0, lowpass_s)


@dataclass(frozen=True, slots=True)
class LoopDelayModel:
    """State of the delay model: commands in flight and its lags. Each of shape (3,), one unit."""

    sent: tuple[tuple[float, Array], ...]  # commands in flight and their times [s], oldest first
    command: Array  # the newest one
    now_s: float
    first: Array  # after half the lag
    arm: Array  # after the whole lag: modelled position of the arm
    filtered: Array  # after the filter: position that the filtered force belongs to
    speed: Array  # of `filtered`, per second
    acceleration: Array  # of `filtered`, per second squared


def at_rest(command: Array) -> LoopDelayModel:
    """Return the steady state of a constant command. Shape (3,)."""
    zero = np.zeros(3)
    return LoopDelayModel(((0.0, command),), command, 0.0, command, command, command, zero, zero)


def follow(
    model: LoopDelayModel, command: Array, dt_s: float, settings: DelayModelSettings
) -> LoopDelayModel:
    """Return the state after `command` was constant for the last `dt_s` [s]. Shape (3,)."""
    sent = model.sent
    if not np.array_equal(command, model.command):
        sent = (*sent, (model.now_s, command))
    steps = max(1, ceil(dt_s / SUBSTEP_S - 1e-9))
    step_s = dt_s / steps
    half_s, filter_s = 0.5 * settings.lag_s, settings.filter_s
    lagging, filtering = (
        1.0 if lag_s <= INSTANT_S else 1.0 - exp(-step_s / lag_s) for lag_s in (half_s, filter_s)
    )
    first, arm, filtered = model.first, model.arm, model.filtered
    at = 0
    for number in range(steps):
        due_s = model.now_s + (number + 0.5) * step_s - settings.delay_s
        while at + 1 < len(sent) and sent[at + 1][0] <= due_s:
            at += 1
        first = first + lagging * (sent[at][1] - first)
        arm = arm + lagging * (first - arm)
        filtered = filtered + filtering * (arm - filtered)
    speed, acceleration = (filtered - model.filtered) / dt_s, np.zeros_like(filtered)
    if min(filter_s, half_s) > INSTANT_S:
        speed = (arm - filtered) / filter_s
        acceleration = ((first - arm) / half_s - speed) / filter_s
    return LoopDelayModel(
        sent[at:], command, model.now_s + dt_s, first, arm, filtered, speed, acceleration
    )


@dataclass(frozen=True, slots=True)
class ContactTravel:
    """Travel of the contact point so far, commanded or measured."""

    T_base_tcp: pin.SE3  # at its end
    delay_model: LoopDelayModel  # base axes
    filtered_travel_m: Array  # travel that the filtered force belongs to, tool axes. Shape (3,)

    @classmethod
    def at_rest(cls, T_base_tcp: pin.SE3) -> "ContactTravel":
        """Return the travel of a tool at rest."""
        return cls(T_base_tcp.copy(), at_rest(np.zeros(3)), np.zeros(3))

    def to(
        self, T_base_tcp: pin.SE3, motion: LawMotion, dt_s: float, settings: DelayModelSettings
    ) -> "ContactTravel":
        """Return the travel up to a pose that was constant for the last `dt_s`."""
        before = self.delay_model
        moved_m, _ = motion_between(self.T_base_tcp, T_base_tcp, motion.lever_m)
        model = follow(before, before.command + moved_m, dt_s, settings)
        travel_m = motion.T_base_tcp.rotation.T @ (model.filtered - before.filtered)
        return ContactTravel(T_base_tcp, model, self.filtered_travel_m + travel_m)
