"""Monitor of a set point stream on the robot's own clock: speed, path and acceleration. Pure.

Three independent rules: the distance of one set point (a token bucket, refilled over time up to one
step), the path length in any 250 ms, and the change of mean velocity and of path length from one
60 ms to the next, so that oscillation does not pass as rest. The state persists over streams and
leases, so that a flood of new ones gains nothing.
"""

from collections import deque
from dataclasses import dataclass, replace

import pinocchio as pin

from common.motion.frames import apart, length, rotation_between
from common.motion.limits import Limits
from forcemesh.faults import tripped
from forcemesh.messages import Trip

# The arbiter limits speed with its own clock and period; a set point may arrive slightly early.
SPEED_MARGIN = 1.25
ACCEL_MARGIN = 1.5
WINDOW_S = 0.25
HALF_S = 0.06  # half of the window of the acceleration
EARLY_S = 0.02  # permitted jitter of a set point
S_PER_NS = 1e-9


@dataclass(frozen=True, slots=True)
class StreamStep:
    """One commanded pose: time, and distance from the previous one."""

    at_ns: int
    T: pin.SE3
    travel_m: float
    turn_rad: float


class SetpointMonitor:
    """Monitor of a set point stream: accepts a set point, or returns the broken limit."""

    def __init__(self, limits: Limits) -> None:
        """Begin with a budget of one step."""
        self._limits = limits
        self._budget_m, self._budget_rad = limits.step_m, limits.step_rad
        self._budget_at_ns: int | None = None
        self._steps: deque[StreamStep] = deque()  # of the last window, and the one before
        self._last: pin.SE3 | None = None  # commanded last, None when something else moved the arm

    def moved_otherwise(self) -> None:
        """Register another motion of the arm: the next stream begins at the measured pose."""
        self._last = None

    def begin(self, T_measured: pin.SE3, now_ns: int) -> Trip | None:
        """Begin a stream at the measured pose; a jump from the last set point counts as path."""
        if self._last is not None and now_ns - self._steps[-1].at_ns < WINDOW_S / S_PER_NS:
            return self.check(T_measured, now_ns)
        self._last = None
        self._put(StreamStep(now_ns, T_measured, 0.0, 0.0))
        return None

    def check(self, T_target: pin.SE3, now_ns: int) -> Trip | None:
        """Check the next set point of the stream; an accepted one consumes budget."""
        if self._last is None:
            return tripped("no_stream", "no stream of set points is active")
        step = StreamStep(now_ns, T_target, *apart(self._last, T_target))
        limits = self._limits
        since_ns = now_ns if self._budget_at_ns is None else self._budget_at_ns
        time_s = SPEED_MARGIN * max(0, now_ns - since_ns) * S_PER_NS
        budget_m = min(self._budget_m + limits.speed_m_s * time_s, limits.step_m)
        budget_rad = min(self._budget_rad + limits.speed_rad_s * time_s, limits.step_rad)
        text = "set points are faster than the speed limit"
        if step.travel_m > budget_m:
            return tripped("speed", text, limit=limits.speed_m_s, unit="m/s")
        if step.turn_rad > budget_rad:
            return tripped("speed", text, limit=limits.speed_rad_s, unit="rad/s")
        recent = [one for one in self._steps if now_ns - one.at_ns < WINDOW_S / S_PER_NS]
        travel_m = step.travel_m + sum([one.travel_m for one in recent])
        turn_rad = step.turn_rad + sum([one.turn_rad for one in recent])
        text = f"longer path in {WINDOW_S * 1e3:g} ms than the speed limit allows"
        for value, speed, unit in (
            (travel_m, limits.speed_m_s, "m"),
            (turn_rad, limits.speed_rad_s, "rad"),
        ):
            most = speed * (SPEED_MARGIN * WINDOW_S)
            if value > most:
                return tripped("rate", text, value=value, limit=most, unit=unit)
        trip = self._acceleration_trip(step)
        if trip is None:
            self._budget_m, self._budget_rad = budget_m - step.travel_m, budget_rad - step.turn_rad
            self._budget_at_ns = now_ns
            self._put(step)
        return trip

    def _acceleration_trip(self, step: StreamStep) -> Trip | None:
        """Compare the last 60 ms with the 60 ms before: mean velocity, and length of the path."""
        half_ns, limits = HALF_S / S_PER_NS, self._limits
        middle, first = (  # each set point holds until the next
            next((one.T for one in reversed(self._steps) if one.at_ns <= at_ns), self._steps[0].T)
            for at_ns in (step.at_ns - half_ns, step.at_ns - 2 * half_ns)
        )
        change_m = (step.T.translation - middle.translation) - (
            middle.translation - first.translation
        )
        change_rad = rotation_between(middle.rotation, step.T.rotation) - rotation_between(
            first.rotation, middle.rotation
        )
        more_m = more_rad = 0.0
        for one in (*self._steps, step):
            age_ns = step.at_ns - one.at_ns
            if age_ns < 2.0 * half_ns:
                sign = 1.0 if age_ns < half_ns else -1.0
                more_m += sign * one.travel_m
                more_rad += sign * one.turn_rad
        text = "acceleration of the set points is above the limit"
        for change, accel, speed in (
            (max(length(change_m), more_m), limits.accel_m_s2, limits.speed_m_s),
            (max(length(change_rad), more_rad), limits.accel_rad_s2, limits.speed_rad_s),
        ):
            if change > ACCEL_MARGIN * accel * HALF_S**2 + speed * EARLY_S:
                return tripped("acceleration", text, value=change / HALF_S**2, limit=accel)
        return None

    def _put(self, step: StreamStep) -> None:
        """Store a step and drop those older than the window, except the one at its start."""
        if self._last is None:  # earlier poses are of another motion: only their distances count
            self._steps = deque(replace(one, T=step.T) for one in self._steps)
        self._steps.append(step)
        self._last = step.T
        while len(self._steps) > 1 and step.at_ns - self._steps[1].at_ns >= WINDOW_S / S_PER_NS:
            self._steps.popleft()
