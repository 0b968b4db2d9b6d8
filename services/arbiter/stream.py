"""Set-point limiter: streamed set points within speed, acceleration and bounds. Pure."""

from dataclasses import dataclass, replace

import pinocchio as pin

from common.motion.frames import is_finite_pose
from common.motion.limits import check_step, check_workspace
from common.motion.rate_limiter import (
    CommandedMotion,
    PathWindow,
    at_rest,
    brake,
    check_rate,
    limit_motion,
    resting_place,
)
from forcemesh.messages import Trip
from services.arbiter.bounds import ArmBounds


@dataclass(frozen=True, slots=True)
class SetpointStream:
    """State of the stream: the last command, and the travel of the last quarter of a second."""

    motion: CommandedMotion
    window: PathWindow


def begin(T_measured: pin.SE3) -> SetpointStream:
    """Return a stream that starts at the measured pose at rest, without a jump."""
    return SetpointStream(at_rest(T_measured), PathWindow())


@dataclass(frozen=True, slots=True)
class Tick:
    """One period: measured pose, time and length."""

    T_measured: pin.SE3
    now_ns: int
    dt_s: float


def follow(
    stream: SetpointStream, T_target: pin.SE3, bounds: ArmBounds, tick: Tick
) -> tuple[SetpointStream, Trip | None]:
    """Return the stream after a target pose, or unchanged with the limit that it violates.

    From every accepted set point the arm can be braked inside the bounds.
    """
    if not is_finite_pose(T_target):
        return stream, check_workspace(bounds.limits, T_target)
    limits, before = bounds.limits, stream.motion.T_base_flange
    motion = limit_motion(limits, stream.motion, T_target, tick.dt_s)
    window = stream.window.after(tick.now_ns, before, motion.T_base_flange)
    trip = (
        bounds.place(resting_place(limits, motion))
        or check_step(limits, tick.T_measured, motion.T_base_flange)
        or check_rate(limits, window)
    )
    return (SetpointStream(motion, window), None) if trip is None else (stream, trip)


def braked(stream: SetpointStream, bounds: ArmBounds, dt_s: float) -> SetpointStream:
    """Return the stream after one period of braking."""
    return replace(stream, motion=brake(bounds.limits, stream.motion, dt_s))
