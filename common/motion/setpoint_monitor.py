"""Monitor of a set point stream on the robot's own clock: speed, path and acceleration. Pure.

Three independent rules: the distance of one set point (a token bucket, refilled over time up to one
step), the path length in any 250 ms, and the change of mean velocity and of path length from one
60 ms to the next, so that oscillation does not pass as rest. The state persists over streams and
leases, so that a flood of new ones gains nothing.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from math import dist
from operator import attrgetter
from typing import Any, NamedTuple

import pinocchio as pin

from common.motion.frames import apart, speeds_between
from common.motion.limits import Limits
from forcemesh.faults import tripped
from forcemesh.messages import Trip

# The arbiter limits speed with its own clock and period; a set point may arrive slightly early.
SPEED_MARGIN = 1.25
ACCEL_MARGIN = 1.5
WINDOW_S, WINDOW_NS = 0.25, 250_000_000
HALF_S, HALF_NS = 0.06, 60_000_000  # half of the window of the acceleration
EARLY_S = 0.02  # permitted jitter of a set point
S_PER_NS = 1e-9
_TIME_OF: Callable[[Any], int] = attrgetter("at_ns")


class StreamStep(NamedTuple):
    """One commanded pose: time, and length of the commanded path up to it."""

    at_ns: int
    T: pin.SE3
    path_m: float = 0.0
    path_rad: float = 0.0


class SetpointMonitor:
    """Monitor of a set point stream: accepts a set point, or returns the broken limit."""

    def __init__(self, limits: Limits) -> None:
        """Begin with a budget of one step."""
        self._limits = limits
        half2_s2 = ACCEL_MARGIN * HALF_S**2
        self._change_m = half2_s2 * limits.accel_m_s2 + limits.speed_m_s * EARLY_S
        self._change_rad = half2_s2 * limits.accel_rad_s2 + limits.speed_rad_s * EARLY_S
        self._budget_m, self._budget_rad = limits.step_m, limits.step_rad
        self._budget_at_ns: int | None = None
        self._steps: deque[StreamStep] = deque()  # of the last window, and the one before
        self._last_ns: int | None = None  # of the last pose; None when something else moves the arm

    def moved_otherwise(self) -> None:
        """Register another motion of the arm: the next stream begins at the measured pose."""
        self._last_ns = None

    def begin(self, T_measured: pin.SE3, now_ns: int) -> Trip | None:
        """Begin a stream at the measured pose; a jump from the last set point counts as path."""
        if self._last_ns is not None and now_ns - self._last_ns < WINDOW_NS:
            return self.check(T_measured, now_ns)
        # Earlier poses are of another motion: only their path counts.
        steps = self._steps or [StreamStep(now_ns, T_measured)]
        self._steps = deque(step._replace(T=T_measured) for step in steps)
        self._last_ns = now_ns
        return None

    def check(self, T_target: pin.SE3, now_ns: int) -> Trip | None:
        """Check the next set point of the stream; an accepted one consumes budget."""
        if self._last_ns is None:
            return tripped("no_stream", "no stream of set points is active")
        limits, steps = self._limits, self._steps
        while len(steps) > 1 and now_ns - steps[1].at_ns >= WINDOW_NS:
            steps.popleft()
        start, newest = steps[0], steps[-1]
        travel_m, turn_rad = apart(newest.T, T_target)
        step = StreamStep(now_ns, T_target, newest.path_m + travel_m, newest.path_rad + turn_rad)
        path_m, path_rad = step.path_m - start.path_m, step.path_rad - start.path_rad
        since_ns = now_ns if self._budget_at_ns is None else self._budget_at_ns
        time_s = SPEED_MARGIN * max(0, now_ns - since_ns) * S_PER_NS
        budget_m = min(self._budget_m + limits.speed_m_s * time_s, limits.step_m)
        budget_rad = min(self._budget_rad + limits.speed_rad_s * time_s, limits.step_rad)
        text = "set points are faster than the speed limit"
        if travel_m > budget_m:
            return tripped("speed", text, limit=limits.speed_m_s, unit="m/s")
        if turn_rad > budget_rad:
            return tripped("speed", text, limit=limits.speed_rad_s, unit="rad/s")
        for value, speed, unit in (
            (path_m, limits.speed_m_s, "m"),
            (path_rad, limits.speed_rad_s, "rad"),
        ):
            most = speed * (SPEED_MARGIN * WINDOW_S)
            if value > most:
                text = f"longer path in {WINDOW_S * 1e3:g} ms than the speed limit allows"
                return tripped("rate", text, value=value, limit=most, unit=unit)
        # The path of the whole window is at least the change between its parts.
        is_fast = path_m > self._change_m or path_rad > self._change_rad
        if is_fast and (trip := self._acceleration_trip(step)) is not None:
            return trip
        self._budget_m, self._budget_rad = budget_m - travel_m, budget_rad - turn_rad
        self._budget_at_ns = self._last_ns = now_ns
        steps.append(step)
        return None

    def _acceleration_trip(self, step: StreamStep) -> Trip | None:
        """Compare the last 60 ms with the 60 ms before: mean velocity, and length of the path."""
        limits, steps = self._limits, self._steps
        middle, first = (  # in force at that time, or the oldest
            steps[max(0, bisect_right(steps, step.at_ns - age_ns, key=_TIME_OF) - 1)]
            for age_ns in (HALF_NS, 2 * HALF_NS)
        )
        halves = (speeds_between(first.T, middle.T, 1.0), speeds_between(middle.T, step.T, 1.0))
        change_m, change_rad = map(dist, *halves)
        more_m = step.path_m - 2.0 * middle.path_m + first.path_m
        more_rad = step.path_rad - 2.0 * middle.path_rad + first.path_rad
        for change, most, accel in (
            (max(change_m, more_m), self._change_m, limits.accel_m_s2),
            (max(change_rad, more_rad), self._change_rad, limits.accel_rad_s2),
        ):
            if change > most:
                text = "acceleration of the set points is above the limit"
                return tripped("acceleration", text, value=change / HALF_S**2, limit=accel)
        return None
