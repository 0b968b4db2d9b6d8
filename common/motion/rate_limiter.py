"""Rate limiter of commanded poses: speed and acceleration per period. Pure: state in, state out.

Excess speed and acceleration are clipped, not refused. Translation and rotation are scaled by the
same factor, so a tool that rotates about its tip still does so.
"""

from math import dist, hypot, sqrt
from typing import NamedTuple

import pinocchio as pin

from common.motion.frames import Speeds, apart, moved, plus, scaled, speeds_between
from common.motion.limits import Limits
from forcemesh.messages import ZERO3

AT_REST = 1e-9  # m/s and rad/s
SAME_INSTANT_S = 1e-6  # shorter periods do not move the pose

REST: Speeds = (ZERO3, ZERO3)


class CommandedMotion(NamedTuple):
    """A commanded flange pose and its velocity, in base axes."""

    T_base_flange: pin.SE3
    T_target: pin.SE3  # target of this period; once it is reached, the same object as the pose
    speeds: Speeds
    lags: bool = False  # behind the target by more than acceleration explains

    @property
    def is_at_rest(self) -> bool:
        """Whether the pose is at rest."""
        return max(map(abs, self.speeds[0] + self.speeds[1])) <= AT_REST


def at_rest(T_base_flange: pin.SE3) -> CommandedMotion:
    """Return the state of a pose at rest."""
    return CommandedMotion(T_base_flange, T_base_flange, REST)


def limit_motion(
    limits: Limits, before: CommandedMotion, T_target: pin.SE3, dt_s: float
) -> CommandedMotion:
    """Return the pose towards a target that speed and acceleration allow after `dt_s` [s].

    A target within the limits is returned as the same object. A target at rest is reached without
    overshoot: the closing speed, relative to the moving target, is limited to what can be braked in
    the remaining distance. While the target changes its speed, the pose falls behind a little and
    catches up; it `lags` when the distance exceeds the braking distance from full speed.

    Args:
        limits: The cell's limits.
        before: Result of the last period.
        T_target: Target of the flange in base; must be finite.
        dt_s: Time since the last period.
    """
    if dt_s < SAME_INSTANT_S:
        return before._replace(T_target=T_target)
    most = (limits.speed_m_s, limits.speed_rad_s)
    most_change = (limits.accel_m_s2 * dt_s, limits.accel_rad_s2 * dt_s)
    needed = allowed = speeds_between(before.T_base_flange, T_target, dt_s)
    if before.T_base_flange is not before.T_target:  # there is a distance to close
        of_target = _limited(REST, speeds_between(before.T_target, T_target, dt_s), most)
        braked = tuple(map(_braked_within, map(dist, of_target, needed), most_change))
        allowed = _limited(of_target, needed, braked)
    allowed = _limited(REST, allowed, most)
    reached = _limited(before.speeds, allowed, most_change)
    if reached is allowed and max(map(dist, reached, needed)) <= AT_REST:
        return CommandedMotion(T_target, T_target, needed)
    T = moved(before.T_base_flange, reached, dt_s)
    left_m, left_rad = apart(T, T_target)
    lag_m = limits.speed_m_s * max(dt_s, 0.5 * limits.speed_m_s / limits.accel_m_s2)
    lag_rad = limits.speed_rad_s * max(dt_s, 0.5 * limits.speed_rad_s / limits.accel_rad_s2)
    return CommandedMotion(T, T_target, reached, lags=left_m > lag_m or left_rad > lag_rad)


def brake(limits: Limits, before: CommandedMotion, dt_s: float) -> CommandedMotion:
    """Return the next pose of the fastest stop."""
    reached = _limited(before.speeds, REST, (limits.accel_m_s2 * dt_s, limits.accel_rad_s2 * dt_s))
    return CommandedMotion(moved(before.T_base_flange, reached, dt_s), before.T_target, reached)


def resting_place(limits: Limits, motion: CommandedMotion) -> pin.SE3:
    """Return the flange pose at the end of braking from now."""
    return moved(motion.T_base_flange, motion.speeds, half_braking_s(limits, motion.speeds))


def half_braking_s(limits: Limits, speeds: Speeds) -> float:
    """Return half of the time in which speeds are braked: times them, the way until then."""
    speed, angular = speeds
    return 0.5 * max(hypot(*speed) / limits.accel_m_s2, hypot(*angular) / limits.accel_rad_s2)


def slowed(
    motion: CommandedMotion, before: CommandedMotion, share: float, dt_s: float
) -> CommandedMotion:
    """Return a motion at a share of its speeds, 0 to 1; it lags behind its target."""
    v, w = motion.speeds
    speeds = scaled(v, share), scaled(w, share)
    T = moved(before.T_base_flange, speeds, dt_s)
    return CommandedMotion(T, motion.T_target, speeds, lags=True)


def _braked_within(speed: float, change: float) -> float:
    """Return the closing speed from which the arm can be braked exactly at the target.

    It is sqrt(h (h + 4 v)) - h for a needed speed v, with h half of the largest change, here
    without cancellation for small v.
    """
    half = 0.5 * change
    return 4.0 * half * speed / (sqrt(half * (half + 4.0 * speed)) + half)


def _limited(start: Speeds, end: Speeds, most: tuple[float, ...]) -> Speeds:
    """Return the speeds from `start` towards `end` that differ by no more than `most`.

    Within these limits they are `end` itself.
    """
    share = 1.0
    for size, largest in zip(map(dist, start, end), most, strict=True):
        if size > largest:
            share = min(share, largest / size)
    if share == 1.0:
        return end
    (v, w), (v_end, w_end) = start, end
    return plus(v, plus(v_end, v, -1.0), share), plus(w, plus(w_end, w, -1.0), share)
