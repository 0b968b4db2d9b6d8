"""Rate limiter of commanded poses: speed and acceleration per period. Pure: state in, state out.

Excess speed and acceleration are clipped, not refused. Translation and rotation are scaled by the
same factor, so a tool that rotates about its tip still does so.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, length, rotation_between, rotation_from_vector
from common.motion.limits import Limits
from forcemesh.faults import tripped
from forcemesh.messages import Trip

WINDOW_S = 0.25  # the path in it is limited, however many commands arrive
WINDOW_MARGIN = 1.25  # periods begin and end inside the window
JOINT_WINDOW_S = 0.1  # averaging window of joint speeds: samples repeat and have jitter
AT_REST = 1e-9  # m/s and rad/s
SAME_INSTANT_S = 1e-6  # shorter periods do not move the pose
NS_PER_S = 1_000_000_000


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
    most = _Most(limits, dt_s)
    now, last = np.array([before.speed_m_s, before.angular_rad_s]), before.T_base_flange
    needed = _between(last, T_target) / dt_s
    target_speed = _between(before.T_target, T_target) / dt_s
    target_speed = target_speed * most.speed(target_speed)
    closing = needed - target_speed
    allowed = target_speed + closing * most.closing(closing)
    allowed = allowed * most.speed(allowed)
    change = allowed - now
    reached = now + change * most.change(change)
    if np.array_equal(reached, now + change) and np.abs(reached - needed).max() <= AT_REST:
        return CommandedMotion(T_target, T_target, needed[0], needed[1])
    motion = _moved(last, T_target, reached, dt_s)
    return replace(motion, lags=most.is_behind(_between(motion.T_base_flange, T_target)))


def brake(limits: Limits, before: CommandedMotion, dt_s: float) -> CommandedMotion:
    """Return the next pose of the fastest stop."""
    now = np.array([before.speed_m_s, before.angular_rad_s])
    reached = now * (1.0 - _Most(limits, dt_s).change(now))
    return _moved(before.T_base_flange, before.T_target, reached, dt_s)


def resting_place(limits: Limits, motion: CommandedMotion) -> pin.SE3:
    """Return the flange pose at the end of braking from now."""
    speed, angular = motion.speed_m_s, motion.angular_rad_s
    half_s = 0.5 * max(length(speed) / limits.accel_m_s2, length(angular) / limits.accel_rad_s2)
    return _displaced(motion.T_base_flange, np.array([speed, angular]) * half_s)


@dataclass(frozen=True, slots=True)
class _Most:
    """Scale factors, at most one, that the limits allow for a pair (translation, rotation)."""

    limits: Limits
    dt_s: float

    def speed(self, pair: Array) -> float:
        return _share(pair, self.limits.speed_m_s, self.limits.speed_rad_s)

    def change(self, pair: Array) -> float:
        accel = (self.limits.accel_m_s2 * self.dt_s, self.limits.accel_rad_s2 * self.dt_s)
        return _share(pair, *accel)

    def closing(self, pair: Array) -> float:
        """Return the factor for a closing speed that brakes exactly at the target."""
        translation = _closing_share(length(pair[0]), 0.5 * self.limits.accel_m_s2 * self.dt_s)
        return min(
            translation, _closing_share(length(pair[1]), 0.5 * self.limits.accel_rad_s2 * self.dt_s)
        )

    def is_behind(self, pair: Array) -> bool:
        limits, dt_s = self.limits, self.dt_s
        lag_m = limits.speed_m_s * max(dt_s, 0.5 * limits.speed_m_s / limits.accel_m_s2)
        lag_rad = limits.speed_rad_s * max(dt_s, 0.5 * limits.speed_rad_s / limits.accel_rad_s2)
        return length(pair[0]) > lag_m or length(pair[1]) > lag_rad


def _closing_share(speed: float, half: float) -> float:
    """Return (sqrt(h (h + 4 v)) - h) / v, at most one, without cancellation for small v."""
    return min(1.0, 4.0 * half / (sqrt(half * (half + 4.0 * speed)) + half))


def _share(pair: Array, most: float, most_rad: float) -> float:
    translation, rotation = length(pair[0]), length(pair[1])
    return min(
        most / translation if translation > most else 1.0,
        most_rad / rotation if rotation > most_rad else 1.0,
    )


def _between(T_from: pin.SE3, T_to: pin.SE3) -> Array:
    rotation = rotation_between(T_from.rotation, T_to.rotation)
    return np.array([T_to.translation - T_from.translation, rotation])


def _displaced(T: pin.SE3, pair: Array) -> pin.SE3:
    return pin.SE3(rotation_from_vector(pair[1]) @ T.rotation, T.translation + pair[0])


def _moved(T: pin.SE3, T_target: pin.SE3, speeds: Array, dt_s: float) -> CommandedMotion:
    return CommandedMotion(_displaced(T, speeds * dt_s), T_target, speeds[0], speeds[1])


# --- windows of time ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PathWindow:
    """Commands of the last quarter of a second: time [ns], distance [m], angle [rad]."""

    steps: tuple[tuple[int, float, float], ...] = ()

    def after(self, now_ns: int, T_from: pin.SE3, T_to: pin.SE3) -> "PathWindow":
        """Return the window with one more step."""
        pair = _between(T_from, T_to)
        first_ns = now_ns - WINDOW_S * NS_PER_S
        recent = [step for step in self.steps if step[0] > first_ns]
        return PathWindow((*recent, (now_ns, length(pair[0]), length(pair[1]))))


def check_rate(limits: Limits, window: PathWindow) -> Trip | None:
    """Refuse a longer path in a window than the speed limits allow, for any number of commands."""
    longest_s = WINDOW_S * WINDOW_MARGIN
    path_m = sum([step[1] for step in window.steps])
    if path_m > limits.speed_m_s * longest_s:
        text = f"{path_m * 1e3:.1f} mm were commanded within {WINDOW_S * 1e3:.0f} ms"
        return tripped("rate", text, value=path_m, limit=limits.speed_m_s * longest_s, unit="m")
    rotation_rad = sum([step[2] for step in window.steps])
    if rotation_rad > limits.speed_rad_s * longest_s:
        text = (
            f"{np.degrees(rotation_rad):.1f} degrees were commanded within {WINDOW_S * 1e3:.0f} ms"
        )
        return tripped(
            "rate", text, value=rotation_rad, limit=limits.speed_rad_s * longest_s, unit="rad"
        )
    return None


@dataclass(frozen=True, slots=True)
class JointTrack:
    """Measured joint angles of the last tenth of a second: time [ns] and angles [rad]."""

    samples: tuple[tuple[int, Array], ...] = ()

    def after(self, stamp_ns: int, joint_rad: Array) -> "JointTrack":
        """Return the track with one more sample; a sample that is not newer changes nothing."""
        if self.samples and stamp_ns <= self.samples[-1][0]:
            return self
        samples = (*self.samples, (stamp_ns, joint_rad))
        first_ns = stamp_ns - round(JOINT_WINDOW_S * NS_PER_S)
        while len(samples) > 1 and samples[1][0] <= first_ns:
            samples = samples[1:]
        return JointTrack(samples)

    @property
    def speed_rad_s(self) -> Array | None:
        """Mean speed over the window, shape (6,); None before the window is full."""
        if not self.samples:
            return None
        (from_ns, q_from), (to_ns, q_to) = self.samples[0], self.samples[-1]
        time_s = (to_ns - from_ns) / NS_PER_S
        return None if time_s < JOINT_WINDOW_S else (q_to - q_from) / time_s
