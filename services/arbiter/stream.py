"""Set-point limiter: streamed set points within speed, acceleration and bounds. Pure."""

from dataclasses import dataclass, replace

import pinocchio as pin

from common.motion.frames import is_finite_pose
from common.motion.limits import check_step, check_workspace
from common.motion.rate_limiter import (
    Pace,
    Window,
    brake,
    check_rate,
    limit_motion,
    resting_place,
    still,
)
from forcemesh.messages import Trip
from services.arbiter.bounds import Bounds


@dataclass(frozen=True, slots=True)
class Stream:
    """State of the stream: the last command, and the travel of the last quarter of a second."""

    pace: Pace
    window: Window


def begin(T_measured: pin.SE3) -> Stream:
    """Return a stream that starts at the measured pose at rest, without a jump."""
    return Stream(still(T_measured), Window())


@dataclass(frozen=True, slots=True)
class Moment:
    """One period: measured pose, time and length."""

    T_measured: pin.SE3
    now_ns: int
    dt_s: float


def follow(
    stream: Stream, T_wished: pin.SE3, bounds: Bounds, moment: Moment
) -> tuple[Stream, Trip | None]:
    """Return the stream after a target pose, or unchanged with the limit that it violates.

    From every accepted set point the arm can be braked inside the bounds.
    """
    if not is_finite_pose(T_wished):
        return stream, check_workspace(bounds.limits, T_wished)
    limits, before = bounds.limits, stream.pace.T_base_flange
    pace = limit_motion(limits, stream.pace, T_wished, moment.dt_s)
    window = stream.window.after(moment.now_ns, before, pace.T_base_flange)
    trip = (
        bounds.place(resting_place(limits, pace))
        or check_step(limits, moment.T_measured, pace.T_base_flange)
        or check_rate(limits, window)
    )
    return (Stream(pace, window), None) if trip is None else (stream, trip)


def faded(stream: Stream, bounds: Bounds, dt_s: float) -> Stream:
    """Return the stream after one period of braking."""
    return replace(stream, pace=brake(bounds.limits, stream.pace, dt_s))
