"""When and how far set points leave for a controller that takes them late. Pure.

A set point is judged when it comes (`common.motion.last_check`), but it leaves when the controller
has taken the one before, and the newest goes in place of all that came meanwhile: what came evenly
would
leave in leaps. So the stream that leaves keeps the limits as well: way in any 250 ms, and how much
more way in 60 ms than in the 60 before. A set point that is too far for now leaves as the part of
its way that is not; the rest follows, or the newest one takes its place. Nothing here ends a
stream: an honest one is at most smoothed. What has waited behind a link that stalled may have been
wanted before the tool touched: it follows no faster than an approach.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf, radians

import numpy as np
import pinocchio as pin

from common.config.cell import Cell, LimitsSection
from common.motion.frames import rotation_between, rotation_from_vector
from common.motion.setpoint_monitor import ACCEL_MARGIN, EARLY_S, HALF_S, SPEED_MARGIN, WINDOW_S
from forcemesh.clock import NS_PER_S
from forcemesh.faults import tripped
from forcemesh.messages import Trip

LATE_S = 0.045  # by so much later than planned a set point may leave
LATE_PERIODS = 2.5  # of the controller's reports without a departure: the link has stalled
HALF_NS, WINDOW_NS = round(HALF_S * NS_PER_S), round(WINDOW_S * NS_PER_S)
RUNS_FROM = 3  # departures: a controller takes one, then its time to plan the first motion
NOTHING = 1e-12  # a way that is none
LEAST_SHARE = 0.25  # a smaller part of a way waits, while something has left lately

Place = Callable[[pin.SE3], Trip | None]


@dataclass(frozen=True, slots=True)
class CatchUp:
    """How a stream goes on after nothing has left for a while."""

    speed_m_s: float = inf
    late_s: float = inf  # so long after the last departure the link has stalled

    @classmethod
    def of(cls, cell: Cell) -> "CatchUp":
        """Take it out of a cell file: as fast as the first touch may be."""
        speed_m_s = min(cell.force.approach_m_s, cell.approach_limit_m_s)
        return cls(speed_m_s, max(LATE_PERIODS / cell.rates.robot_hz, LATE_S))


@dataclass(frozen=True, slots=True)
class Left:
    """How far a set point was from the one before, and when it left."""

    at_ns: int
    way_m: float
    turn_rad: float


class Departures:
    """The stream of set points as it leaves."""

    def __init__(
        self,
        limits: LimitsSection,
        place: Place,
        catch_up: CatchUp | None = None,
        step: tuple[float, float] = (inf, inf),
    ) -> None:
        """Begin with nothing left. `place` judges where a pose lies that nobody has commanded.

        `step` is how far one set point may be from the one before [m, rad]: the controller refuses
        more.
        """
        self._step = step
        self._speed = (limits.speed_m_s, radians(limits.speed_deg_s))
        self._accel = (limits.accel_m_s2, radians(limits.accel_deg_s2))
        self._place = place
        self._left: deque[Left] = deque()  # in the last window
        self._last: pin.SE3 | None = None  # None: something else moved the arm
        self._flows = False  # a stream was begun and is not over
        self._catch_up = catch_up or CatchUp()
        self._last_ns: int | None = None  # of the last departure of a stream that runs
        self._departed = 0  # of this stream
        self._backlog_m = 0.0  # of what waited behind a stalled link and has not left

    @property
    def last(self) -> pin.SE3 | None:
        """The pose that left last."""
        return self._last

    def moved_otherwise(self) -> None:
        """The arm goes where no set point said: the next one is a beginning."""
        self._last = None

    def seed(self, T_measured: pin.SE3, now_ns: int) -> Trip | None:
        """Judge the beginning of a stream, which may only leave as it is."""
        if self.share(T_measured, now_ns) < 1.0:
            return tripped("acceleration", "the arm is too far from the set point that left last")
        self._flows = True
        return None

    def end(self) -> None:
        """End the stream: what has not left stays."""
        self._flows, self._departed = False, 0
        self._last_ns, self._backlog_m = None, 0.0

    def leave(self, T_wanted: pin.SE3, now_ns: int) -> pin.SE3 | None:
        """Return what leaves now, `T_wanted` itself or a pose on the way; None: not yet."""
        share = self.share(T_wanted, now_ns)
        if not self._flows or (share < LEAST_SHARE and self._left):
            return None
        share = min(share, self._share_behind(T_wanted, now_ns), self._share_of_step(T_wanted))
        T = T_wanted
        if share < 1.0 and self._last is not None:
            T = _between(self._last, T_wanted, share)
            if self._place(T) is not None:
                return None
        self._left.append(Left(now_ns, *_steps(self._last, T)))
        self._departed += 1
        self._last, self._last_ns = T, now_ns if self._departed >= RUNS_FROM else None
        return T

    def _share_behind(self, T: pin.SE3, now_ns: int) -> float:
        """Return how much of the way may leave behind a link that stalled: all if none did.

        Only what waited is slow: a stream that runs on fast would else never be caught up with.
        """
        if self._last_ns is None:
            return 1.0
        since_s = (now_ns - self._last_ns) / NS_PER_S
        way_m = _steps(self._last, T)[0]
        most_m = self._catch_up.speed_m_s * min(since_s, LATE_S)
        if since_s > self._catch_up.late_s:
            self._backlog_m = way_m
        if self._backlog_m <= 0.0 or way_m <= most_m:
            self._backlog_m = 0.0
            return 1.0
        self._backlog_m -= most_m
        return most_m / way_m

    def _share_of_step(self, T: pin.SE3) -> float:
        """Return how much of the way is one step."""
        ways = zip(_steps(self._last, T), self._step, strict=True)
        return min(most / max(way, NOTHING) for way, most in ways)

    def share(self, T: pin.SE3, now_ns: int) -> float:
        """Return how much of the way to a pose may leave now, 0 to 1."""
        while self._left and now_ns - self._left[0].at_ns > WINDOW_NS:
            self._left.popleft()
        used = (self._used("way_m", now_ns), self._used("turn_rad", now_ns))
        share = 1.0
        for step, (window, more), speed, accel in zip(
            _steps(self._last, T), used, self._speed, self._accel, strict=True
        ):
            room = min(
                SPEED_MARGIN * speed * (WINDOW_S + LATE_S) - window,
                ACCEL_MARGIN * accel * HALF_S**2 + speed * (EARLY_S + LATE_S) - more,
            )
            if step > room:
                share = min(share, max(0.0, room) / max(step, NOTHING))
        return share

    def _used(self, name: str, now_ns: int) -> tuple[float, float]:
        """Return what left in the window, and by how much the last 60 ms exceed those before."""
        sizes = [(now_ns - one.at_ns, float(getattr(one, name))) for one in self._left]
        newer = sum(size for age_ns, size in sizes if age_ns < HALF_NS)
        older = sum(size for age_ns, size in sizes if HALF_NS <= age_ns < 2 * HALF_NS)
        return sum(size for _, size in sizes), newer - older


def _steps(T_from: pin.SE3 | None, T_to: pin.SE3) -> tuple[float, float]:
    """Return way [m] and turn [rad] from one pose to another; nothing from none."""
    if T_from is None:
        return 0.0, 0.0
    way = T_to.translation - T_from.translation
    turn = rotation_between(T_from.rotation, T_to.rotation)
    return float(np.linalg.norm(way)), float(np.linalg.norm(turn))


def _between(T_from: pin.SE3, T_to: pin.SE3, share: float) -> pin.SE3:
    """Return the pose after a share of a straight way with an even turn about one axis."""
    turn = rotation_between(T_from.rotation, T_to.rotation)
    R = rotation_from_vector(share * turn) @ T_from.rotation
    way = T_to.translation - T_from.translation
    return pin.SE3(R, T_from.translation + share * way)
