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

from common.config.plant import Delays
from common.motion.frames import Vector, plus, rotated_back, scaled
from control.law import LawInput, motion_between
from forcemesh.messages import ZERO3, Vec3

INSTANT_S = 1e-5  # a shorter lag counts as zero
SUBSTEP_S = 0.001  # three lags in series are accurate enough in steps of a millisecond


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

    def follow(self, command: Vector, dt_s: float, settings: Delays) -> None:
        """Advance by `dt_s` [s], during which `command` was constant. Shape (3,)."""
        sent, half_s, filter_s = self.sent, 0.5 * settings.lag_s, settings.filter_s
        if command != self.command:
            sent.append((self.now_s, command))
        steps = max(1, ceil(dt_s / SUBSTEP_S - 1e-9))
        step_s, (a, b, c), (d, e, f), (g, h, i) = dt_s / steps, self.first, self.arm, self.filtered
        lagging, filtering = [
            1.0 if lag_s <= INSTANT_S else 1.0 - exp(-step_s / lag_s)
            for lag_s in (half_s, filter_s)
        ]
        for number in range(steps):
            due_s = self.now_s + (number + 0.5) * step_s - settings.delay_s
            while len(sent) > 1 and sent[1][0] <= due_s:
                sent.popleft()
            x, y, z = sent[0][1]  # after half the lag a, b, c; after all of it d, e, f
            a, b, c = a + lagging * (x - a), b + lagging * (y - b), c + lagging * (z - c)
            d, e, f = d + lagging * (a - d), e + lagging * (b - e), f + lagging * (c - f)
            g, h, i = g + filtering * (d - g), h + filtering * (e - h), i + filtering * (f - i)
        before, self.filtered = self.filtered, (g, h, i)
        self.first, self.arm = (a, b, c), (d, e, f)
        if min(filter_s, half_s) > INSTANT_S:
            self.speed = scaled(plus(self.arm, self.filtered, -1.0), 1.0 / filter_s)
            arm_speed = scaled(plus(self.first, self.arm, -1.0), 1.0 / half_s)
            self.acceleration = scaled(plus(arm_speed, self.speed, -1.0), 1.0 / filter_s)
        else:
            self.speed = scaled(plus(self.filtered, before, -1.0), 1.0 / dt_s)
        self.command, self.now_s = command, self.now_s + dt_s


@dataclass(slots=True)
class ContactTravel:
    """Travel of the contact point so far, commanded or measured; advanced in place."""

    T_base_tcp: pin.SE3  # at its end
    delay_model: LoopDelayModel = field(default_factory=lambda: LoopDelayModel(ZERO3))  # base axes
    filtered_travel_m: Vec3 = ZERO3  # travel that the filtered force belongs to, tool axes

    def follow(self, T_base_tcp: pin.SE3, sample: LawInput, dt_s: float, settings: Delays) -> None:
        """Add the travel to a pose that was constant for the last `dt_s`."""
        model, before_m = self.delay_model, self.delay_model.filtered
        moved_m, _ = motion_between(self.T_base_tcp, T_base_tcp, sample.motion.lever_m)
        model.follow(plus(model.command, moved_m), dt_s, settings)
        travel_m = rotated_back(sample.R_base_task, plus(model.filtered, before_m, -1.0))
        self.filtered_travel_m = plus(self.filtered_travel_m, travel_m)
        self.T_base_tcp = T_base_tcp
