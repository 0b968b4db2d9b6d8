"""Delay model of the Smith predictor: between command and filtered force. Pure.

    command -> dead time -> lag/2 -> lag/2 -> filter -> travel that the present force belongs to

Dead time covers controller, processes and the median filter; two first-order lags model the servo,
a third the low-pass of the wrench filter. The half period between two commands needs no term: a
command holds until the next one (zero-order hold). `adaptive.py` predicts the force with it.

`ContactTravel` passes the travel of the contact point through the model. A rotation about the TCP
moves that point too. Travel is accumulated along the tool axes of each period, so that a later
rotation does not turn travel across the tool axis into travel along it.
"""

from collections import deque
from dataclasses import dataclass, field
from math import ceil, exp

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Rows, Vector, plus, rotated
from forcemesh.messages import ZERO3, Vec3
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


class LoopDelayModel:
    """Delay model along three axes, all of one unit; advanced in place."""

    def __init__(self, command: Vector) -> None:
        """Start in the steady state of a constant command. Shape (3,), as the others."""
        self.command = command  # the newest one
        self.sent = deque([(0.0, command)])  # in flight, and since when [s]; oldest first
        self.now_s = 0.0
        self.first = command  # after half the lag
        self.arm = command  # after the whole lag: modelled position of the arm
        self.filtered = command  # after the filter: position that the filtered force belongs to
        self.speed: Vector = ZERO3  # of `filtered`, per second
        self.acceleration: Vector = ZERO3  # of `filtered`, per second squared

    def follow(self, command: Vector, dt_s: float, settings: DelayModelSettings) -> None:
        """Advance by `dt_s` [s], during which `command` was constant. Shape (3,)."""
        sent, half_s, filter_s = self.sent, 0.5 * settings.lag_s, settings.filter_s
        if command != self.command:
            sent.append((self.now_s, command))
        steps = max(1, ceil(dt_s / SUBSTEP_S - 1e-9))
        step_s, executed = dt_s / steps, []
        for number in range(steps):
            due_s = self.now_s + (number + 0.5) * step_s - settings.delay_s
            while len(sent) > 1 and sent[1][0] <= due_s:
                sent.popleft()
            executed.append(sent[0][1])
        lagging, filtering = (
            1.0 if lag_s <= INSTANT_S else 1.0 - exp(-step_s / lag_s)
            for lag_s in (half_s, filter_s)
        )
        axes = []
        for axis, before in enumerate(self.filtered):
            first, arm, filtered = self.first[axis], self.arm[axis], before
            for position in executed:
                first += lagging * (position[axis] - first)
                arm += lagging * (first - arm)
                filtered += filtering * (arm - filtered)
            speed, acceleration = (filtered - before) / dt_s, 0.0
            if min(filter_s, half_s) > INSTANT_S:
                speed = (arm - filtered) / filter_s
                acceleration = ((first - arm) / half_s - speed) / filter_s
            axes.append((first, arm, filtered, speed, acceleration))
        self.first, self.arm, self.filtered, self.speed, self.acceleration = zip(*axes, strict=True)
        self.command, self.now_s = command, self.now_s + dt_s


@dataclass(slots=True)
class ContactTravel:
    """Travel of the contact point so far, commanded or measured; advanced in place."""

    T_base_tcp: pin.SE3  # at its end
    delay_model: LoopDelayModel = field(default_factory=lambda: LoopDelayModel(ZERO3))  # base axes
    filtered_travel_m: Vec3 = ZERO3  # travel that the filtered force belongs to, tool axes

    def follow(
        self, T_base_tcp: pin.SE3, motion: LawMotion, dt_s: float, settings: DelayModelSettings
    ) -> None:
        """Add the travel to a pose that was constant for the last `dt_s`."""
        model, before_m = self.delay_model, self.delay_model.filtered
        moved_m, _ = motion_between(self.T_base_tcp, T_base_tcp, motion.lever_m)
        model.follow(plus(model.command, moved_m), dt_s, settings)
        R_tcp_base: Rows = motion.T_base_tcp.rotation.T.tolist()
        travel_m = rotated(R_tcp_base, plus(model.filtered, before_m, -1.0))
        self.filtered_travel_m = plus(self.filtered_travel_m, travel_m)
        self.T_base_tcp = T_base_tcp
