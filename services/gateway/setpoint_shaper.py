"""Set-point shaper: sliding-window rate limiter of the set points sent to the controller. Pure.

A set point is checked when it is received (`common.motion.arm_check`), but it is sent when the
controller has executed the one before, and the newest replaces all others received meanwhile: an
even stream would be sent in leaps. The sent stream therefore keeps the limits as well: the travel
in any 250 ms (speed), and the increase of the travel in 60 ms over the 60 ms before (acceleration).
Of a set point that is too far, only the permitted share of the travel is sent; the rest follows, or
a newer set point replaces it. The shaper ends no stream: a valid one is at most smoothed. Set
points that waited behind a stalled link may date from before contact: they follow no faster than an
approach.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf, radians

import pinocchio as pin

from common.config.cell import CellConfig, LimitsSection
from common.motion.frames import apart, interpolated
from common.motion.setpoint_monitor import ACCEL_MARGIN, EARLY_S, HALF_S, SPEED_MARGIN, WINDOW_S
from forcemesh.clock import NS_PER_S
from forcemesh.faults import tripped
from forcemesh.messages import Trip

LATE_SETPOINT_S = 0.045  # largest delay of a set point against its schedule
LATE_PERIODS = 2.5  # report periods without a set point sent: the link has stalled
HALF_NS, WINDOW_NS = round(HALF_S * NS_PER_S), round(WINDOW_S * NS_PER_S)
RUNS_FROM = 3  # set points sent before stalls count: the controller plans its first motion
NOTHING = 1e-12  # avoids a division by zero travel
LEAST_SHARE = 0.25  # a smaller share of the travel waits while the window is not empty

PoseCheck = Callable[[pin.SE3], Trip | None]
Steps = tuple[float, float]  # from one set point to the next [m, rad]


@dataclass(frozen=True, slots=True)
class CatchUp:
    """Catch-up speed of a stream after a stall of the link."""

    speed_m_s: float = inf
    late_s: float = inf  # time since the last set point sent that counts as a stall

    @classmethod
    def of(cls, cell: CellConfig) -> "CatchUp":
        """Return the settings of a cell: the catch-up speed is that of an approach.

        A pause within the delay of the controller is its own pacing and no stall.
        """
        plant = cell.plant
        late_s = max(LATE_PERIODS / plant.robot_hz, LATE_SETPOINT_S, plant.robot_delay_s)
        return cls(plant.approach_m_s, late_s)


class SetpointShaper:
    """Stream of set points as sent to the controller."""

    def __init__(
        self,
        limits: LimitsSection,
        place: PoseCheck,
        catch_up: CatchUp | None = None,
        step: Steps = (inf, inf),
    ) -> None:
        """Start with nothing sent. `place` checks interpolated poses, which no client commanded.

        `step` is the largest distance between two set points that the controller accepts.
        """
        self._step = step
        self._speed = (limits.speed_m_s, radians(limits.speed_deg_s))
        self._accel = (limits.accel_m_s2, radians(limits.accel_deg_s2))
        self._place = place
        self._sent: deque[tuple[int, Steps]] = deque()  # in the last window, each with its time
        self.last: pin.SE3 | None = None  # pose sent last; None: the arm was moved otherwise
        self._flows = False  # a stream is active
        self._catch_up = catch_up or CatchUp()
        self._last_ns: int | None = None  # time of the last set point sent of a running stream
        self._sent_count = 0  # set points sent of this stream
        self._backlog_m = 0.0  # travel that waited behind a stalled link and is not sent yet

    def moved_otherwise(self) -> None:
        """Register motion without set points: the next one begins a stream."""
        self.last = None

    def seed(self, T_measured: pin.SE3, now_ns: int) -> Trip | None:
        """Check the first set point of a stream, which can only be sent unchanged."""
        if self.share(self._steps_to(T_measured), now_ns) < 1.0:
            return tripped("acceleration", "the arm is too far from the last set point sent")
        self._flows = True
        return None

    def end(self) -> None:
        """End the stream: unsent set points are dropped."""
        self._flows, self._sent_count = False, 0
        self._last_ns, self._backlog_m = None, 0.0

    def release(self, T_target: pin.SE3, now_ns: int) -> pin.SE3 | None:
        """Return the pose to send now, `T_target` or one towards it; None: not yet."""
        steps = self._steps_to(T_target)
        share = self.share(steps, now_ns)
        if not self._flows or (share < LEAST_SHARE and self._sent):
            return None
        share = min(share, self._share_behind(steps[0], now_ns), self._share_of_step(steps))
        T = T_target
        if share < 1.0 and self.last is not None:
            T = interpolated(self.last, T_target, share)
            if self._place(T) is not None:
                return None
        self._sent.append((now_ns, (share * steps[0], share * steps[1])))
        self._sent_count += 1
        self.last, self._last_ns = T, now_ns if self._sent_count >= RUNS_FROM else None
        return T

    def _share_behind(self, travel_m: float, now_ns: int) -> float:
        """Return the permitted share of the travel after a stall, 1 without one.

        Only the backlog is slow: a fast stream could otherwise never be caught up.
        """
        if self._last_ns is None:
            return 1.0
        since_s = (now_ns - self._last_ns) / NS_PER_S
        most_m = self._catch_up.speed_m_s * min(since_s, LATE_SETPOINT_S)
        if since_s > self._catch_up.late_s:
            self._backlog_m = travel_m
        if self._backlog_m <= 0.0 or travel_m <= most_m:
            self._backlog_m = 0.0
            return 1.0
        self._backlog_m -= most_m
        return most_m / travel_m

    def _share_of_step(self, steps: Steps) -> float:
        """Return the share of the travel that is one step."""
        return min(most / max(step, NOTHING) for step, most in zip(steps, self._step, strict=True))

    def share(self, steps: Steps, now_ns: int) -> float:
        """Return the share of the travel to a pose that may be sent now, 0 to 1."""
        while self._sent and now_ns - self._sent[0][0] > WINDOW_NS:
            self._sent.popleft()
        share = 1.0
        for place, (step, speed, accel) in enumerate(
            zip(steps, self._speed, self._accel, strict=True)
        ):
            window = more = 0.0  # travel in the window; in the last 60 ms minus the 60 ms before
            for at_ns, sent in self._sent:
                age_ns = now_ns - at_ns
                window += sent[place]
                if age_ns < 2 * HALF_NS:
                    more += sent[place] if age_ns < HALF_NS else -sent[place]
            room = min(
                SPEED_MARGIN * speed * (WINDOW_S + LATE_SETPOINT_S) - window,
                ACCEL_MARGIN * accel * HALF_S**2 + speed * (EARLY_S + LATE_SETPOINT_S) - more,
            )
            if step > room:
                share = min(share, max(0.0, room) / max(step, NOTHING))
        return share

    def _steps_to(self, T: pin.SE3) -> Steps:
        """Return travel [m] and rotation [rad] from the last pose sent, zero without one."""
        return (0.0, 0.0) if self.last is None else apart(self.last, T)
