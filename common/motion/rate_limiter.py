"""Rate limiter of commanded poses: speed and acceleration per period. Pure: state in, state out.

Excess speed and acceleration are clipped, not refused. Translation and rotation are scaled by the
same factor, so a tool that rotates about its tip still does so.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, apart, length, rotate_about_base_axes, rotation_between
from common.motion.limits import Limits

AT_REST = 1e-9  # m/s and rad/s
SAME_INSTANT_S = 1e-6  # shorter periods do not move the pose


@dataclass(frozen=True, slots=True)
class CommandedMotion:
    """A commanded flange pose and its velocity, in base axes."""

    T_base_flange: pin.SE3
    T_target: pin.SE3  # target of this period
    speed_m_s: Array  # shape (3,)
    angular_rad_s: Array  # shape (3,)
    lags: bool = False  # behind the target by more than acceleration explains

    @property
    def is_at_target(self) -> bool:
        """Whether the pose equals the target."""
        return self.T_base_flange is self.T_target

    @property
    def is_at_rest(self) -> bool:
        """Whether the pose is at rest."""
        speeds = self.speed_m_s.tolist() + self.angular_rad_s.tolist()
        return all(abs(speed) <= AT_REST for speed in speeds)


def at_rest(T_base_flange: pin.SE3) -> CommandedMotion:
    """Return the state of a pose at rest."""
    return CommandedMotion(T_base_flange, T_base_flange, np.zeros(3), np.zeros(3))


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
        return replace(before, T_target=T_target)
    most = (limits.speed_m_s, limits.speed_rad_s)
    most_change = (limits.accel_m_s2 * dt_s, limits.accel_rad_s2 * dt_s)
    now = np.array([before.speed_m_s, before.angular_rad_s])
    needed = _between(before.T_base_flange, T_target) / dt_s
    target_speed = _between(before.T_target, T_target) / dt_s
    target_speed = target_speed * _share(target_speed, most)
    closing = needed - target_speed
    allowed = target_speed + closing * _closing_share(closing, most_change)
    allowed = allowed * _share(allowed, most)
    change = allowed - now
    reached = now + change * _share(change, most_change)
    if np.array_equal(reached, now + change) and np.abs(reached - needed).max() <= AT_REST:
        return CommandedMotion(T_target, T_target, needed[0], needed[1])
    motion = _moved(before, reached, dt_s)
    left_m, left_rad = apart(motion.T_base_flange, T_target)
    lag_m = limits.speed_m_s * max(dt_s, 0.5 * limits.speed_m_s / limits.accel_m_s2)
    lag_rad = limits.speed_rad_s * max(dt_s, 0.5 * limits.speed_rad_s / limits.accel_rad_s2)
    return replace(motion, T_target=T_target, lags=left_m > lag_m or left_rad > lag_rad)


def brake(limits: Limits, before: CommandedMotion, dt_s: float) -> CommandedMotion:
    """Return the next pose of the fastest stop."""
    now = np.array([before.speed_m_s, before.angular_rad_s])
    reached = now * (1.0 - _share(now, (limits.accel_m_s2 * dt_s, limits.accel_rad_s2 * dt_s)))
    return _moved(before, reached, dt_s)


def resting_place(limits: Limits, motion: CommandedMotion) -> pin.SE3:
    """Return the flange pose at the end of braking from now."""
    speed, angular = motion.speed_m_s, motion.angular_rad_s
    half_s = 0.5 * max(length(speed) / limits.accel_m_s2, length(angular) / limits.accel_rad_s2)
    return _moved(motion, np.array([speed, angular]), half_s).T_base_flange


def _closing_share(pair: Array, most_change: tuple[float, float]) -> float:
    """Return the factor, at most one, for a closing speed that brakes exactly at the target.

    It is (sqrt(h (h + 4 v)) - h) / v with h half of the largest change, without cancellation for
    small v.
    """
    shares = [1.0]
    for row, change in zip(pair, most_change, strict=True):
        half = 0.5 * change
        shares.append(4.0 * half / (sqrt(half * (half + 4.0 * length(row))) + half))
    return min(shares)


def _share(pair: Array, most: tuple[float, float]) -> float:
    """Return the factor, at most one, that keeps translation and rotation within their limits."""
    translation, rotation = length(pair[0]), length(pair[1])
    return min(
        most[0] / translation if translation > most[0] else 1.0,
        most[1] / rotation if rotation > most[1] else 1.0,
    )


def _between(T_from: pin.SE3, T_to: pin.SE3) -> Array:
    rotation = rotation_between(T_from.rotation, T_to.rotation)
    return np.array([T_to.translation - T_from.translation, rotation])


def _moved(before: CommandedMotion, speeds: Array, dt_s: float) -> CommandedMotion:
    """Return the motion after a time at constant speeds: translation, then rotation. (2, 3)."""
    T, (translation, rotation) = before.T_base_flange, speeds * dt_s
    moved = pin.SE3(rotate_about_base_axes(T.rotation, rotation), T.translation + translation)
    return CommandedMotion(moved, before.T_target, speeds[0], speeds[1])
