"""How commanded poses may move from one period to the next. Pure: state in, state out.

Speed and acceleration are limited, not refused: a wish that asks for more fades. Way and turn are
cut by the same share, so a tool that turns about its tip still turns about its tip.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, length, rotation_between, rotation_from_vector
from common.motion.limits import Limits
from forcemesh.faults import tripped
from forcemesh.messages import Trip

WINDOW_S = 0.25  # no flood of commands gets farther in it than the speed limit allows
WINDOW_MARGIN = 1.25  # periods begin and end inside the window
JOINT_WINDOW_S = 0.1  # joint speeds are a mean over it: samples repeat, and come with jitter
AT_REST = 1e-9  # m/s and rad/s
INSTANT_S = 1e-6  # in less time nothing moves
NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Pace:
    """A commanded flange pose and how it moves, in base axes."""

    T_base_flange: pin.SE3
    T_wished: pin.SE3  # what was asked for in this period
    speed_m_s: Array  # shape (3,)
    turning_rad_s: Array  # shape (3,)
    lags: bool = False  # behind the wish by more than acceleration alone explains

    @property
    def is_there(self) -> bool:
        """Whether the pose is the very one that was asked for."""
        return self.T_base_flange is self.T_wished

    @property
    def is_still(self) -> bool:
        """Whether the pose has come to rest."""
        speeds = self.speed_m_s.tolist() + self.turning_rad_s.tolist()
        return all(abs(speed) <= AT_REST for speed in speeds)


def still(T_base_flange: pin.SE3) -> Pace:
    """Return the pace of a pose at rest."""
    return Pace(T_base_flange, T_base_flange, np.zeros(3), np.zeros(3))


def limit_motion(limits: Limits, before: Pace, T_wished: pin.SE3, dt_s: float) -> Pace:
    """Return the pose on the way to a wish that speed and acceleration allow after `dt_s` [s].

    A wish within the limits comes back as the very same object. A standing one is reached without
    going beyond it: the way that is left is closed no faster than it can be braked, measured from
    the wish as it moves. While a stream changes its speed it runs ahead a little and is caught up
    with; it `lags` when it runs ahead farther than a motion at full speed takes to brake.

    Args:
        limits: The cell's limits.
        before: What the last period commanded.
        T_wished: Flange in base; must be finite.
        dt_s: Time since the last period.
    """
    if dt_s < INSTANT_S:
        return replace(before, T_wished=T_wished)
    most = _Most(limits, dt_s)
    now, last = np.array([before.speed_m_s, before.turning_rad_s]), before.T_base_flange
    asked = _between(last, T_wished) / dt_s
    wish = _between(before.T_wished, T_wished) / dt_s
    wish = wish * most.speed(wish)
    closing = asked - wish
    wanted = wish + closing * most.closing(closing)
    wanted = wanted * most.speed(wanted)
    change = wanted - now
    reached = now + change * most.change(change)
    if np.array_equal(reached, now + change) and np.abs(reached - asked).max() <= AT_REST:
        return Pace(T_wished, T_wished, asked[0], asked[1])
    pace = _moved(last, T_wished, reached, dt_s)
    return replace(pace, lags=most.is_behind(_between(pace.T_base_flange, T_wished)))


def brake(limits: Limits, before: Pace, dt_s: float) -> Pace:
    """Return the next pose on the shortest way to rest."""
    now = np.array([before.speed_m_s, before.turning_rad_s])
    reached = now * (1.0 - _Most(limits, dt_s).change(now))
    return _moved(before.T_base_flange, before.T_wished, reached, dt_s)


def resting_place(limits: Limits, pace: Pace) -> pin.SE3:
    """Return the flange pose where this motion would end if it were braked now."""
    way, turn = pace.speed_m_s, pace.turning_rad_s
    half_s = 0.5 * max(length(way) / limits.accel_m_s2, length(turn) / limits.accel_rad_s2)
    return _along(pace.T_base_flange, np.array([way, turn]) * half_s)


@dataclass(frozen=True, slots=True)
class _Most:
    """The share of a pair (way, turn) that the limits allow, at most one."""

    limits: Limits
    dt_s: float

    def speed(self, pair: Array) -> float:
        return _share(pair, self.limits.speed_m_s, self.limits.speed_rad_s)

    def change(self, pair: Array) -> float:
        accel = (self.limits.accel_m_s2 * self.dt_s, self.limits.accel_rad_s2 * self.dt_s)
        return _share(pair, *accel)

    def closing(self, pair: Array) -> float:
        """Speeds from which steps, each slower by the limit, end exactly at the wish."""
        way = _closing_share(length(pair[0]), 0.5 * self.limits.accel_m_s2 * self.dt_s)
        return min(way, _closing_share(length(pair[1]), 0.5 * self.limits.accel_rad_s2 * self.dt_s))

    def is_behind(self, pair: Array) -> bool:
        limits, dt_s = self.limits, self.dt_s
        way_m = limits.speed_m_s * max(dt_s, 0.5 * limits.speed_m_s / limits.accel_m_s2)
        turn_rad = limits.speed_rad_s * max(dt_s, 0.5 * limits.speed_rad_s / limits.accel_rad_s2)
        return length(pair[0]) > way_m or length(pair[1]) > turn_rad


def _closing_share(speed: float, half: float) -> float:
    """Return (sqrt(h (h + 4 v)) - h) / v, at most one, without losing digits where v is small."""
    return min(1.0, 4.0 * half / (sqrt(half * (half + 4.0 * speed)) + half))


def _share(pair: Array, most: float, most_rad: float) -> float:
    way, turn = length(pair[0]), length(pair[1])
    return min(most / way if way > most else 1.0, most_rad / turn if turn > most_rad else 1.0)


def _between(T_from: pin.SE3, T_to: pin.SE3) -> Array:
    turn = rotation_between(T_from.rotation, T_to.rotation)
    return np.array([T_to.translation - T_from.translation, turn])


def _along(T: pin.SE3, pair: Array) -> pin.SE3:
    return pin.SE3(rotation_from_vector(pair[1]) @ T.rotation, T.translation + pair[0])


def _moved(T: pin.SE3, T_wished: pin.SE3, speeds: Array, dt_s: float) -> Pace:
    return Pace(_along(T, speeds * dt_s), T_wished, speeds[0], speeds[1])


# --- windows of time ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Window:
    """What was commanded in the last quarter of a second: time [ns], way [m], turn [rad]."""

    steps: tuple[tuple[int, float, float], ...] = ()

    def after(self, now_ns: int, T_from: pin.SE3, T_to: pin.SE3) -> "Window":
        """Return the window with one more step."""
        pair = _between(T_from, T_to)
        first_ns = now_ns - WINDOW_S * NS_PER_S
        kept = [step for step in self.steps if step[0] > first_ns]
        return Window((*kept, (now_ns, length(pair[0]), length(pair[1]))))


def check_rate(limits: Limits, window: Window) -> Trip | None:
    """Refuse more way in a window than the speed limits allow, however many commands it took."""
    longest_s = WINDOW_S * WINDOW_MARGIN
    way_m = sum([step[1] for step in window.steps])
    if way_m > limits.speed_m_s * longest_s:
        text = f"{way_m * 1e3:.1f} mm were commanded within {WINDOW_S * 1e3:.0f} ms"
        return tripped("rate", text, value=way_m, limit=limits.speed_m_s * longest_s)
    turn_rad = sum([step[2] for step in window.steps])
    if turn_rad > limits.speed_rad_s * longest_s:
        text = f"{np.degrees(turn_rad):.1f} degrees were commanded within {WINDOW_S * 1e3:.0f} ms"
        return tripped("rate", text, value=turn_rad, limit=limits.speed_rad_s * longest_s)
    return None


@dataclass(frozen=True, slots=True)
class JointTrack:
    """Measured joint angles of the last tenth of a second: time [ns] and angles [rad]."""

    samples: tuple[tuple[int, Array], ...] = ()

    def after(self, stamp_ns: int, joint_rad: Array) -> "JointTrack":
        """Return the track with one more sample; one that is not newer changes nothing."""
        if self.samples and stamp_ns <= self.samples[-1][0]:
            return self
        samples = (*self.samples, (stamp_ns, joint_rad))
        first_ns = stamp_ns - round(JOINT_WINDOW_S * NS_PER_S)
        while len(samples) > 1 and samples[1][0] <= first_ns:
            samples = samples[1:]
        return JointTrack(samples)

    @property
    def speed_rad_s(self) -> Array | None:
        """Mean speed over the window, shape (6,); None before there is a whole one."""
        if not self.samples:
            return None
        (from_ns, q_from), (to_ns, q_to) = self.samples[0], self.samples[-1]
        time_s = (to_ns - from_ns) / NS_PER_S
        return None if time_s < JOINT_WINDOW_S else (q_to - q_from) / time_s
