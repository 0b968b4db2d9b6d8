"""Streamed set points: follow the regulator's target, and come to rest. Pure.

The reaction to a cause of a stop is one table, by its fault code:

hold     the permission is revoked at once and the robot brakes; for every code not listed
fade     streamed set points come to rest at the limit of acceleration, then hold
retreat  if the cell file enables it, the tool retracts a little along its axis, then hold

Only set points that the regulator streams can fade or retract: any other motion is held.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import pinocchio as pin

from common.config.cell import ForceSection
from common.motion.frames import apart, dot, is_finite_pose
from common.motion.joint_space import JointStream
from common.motion.limits import NS_PER_S, ArmBounds, Limits, check_apart, check_workspace
from common.motion.rate_limiter import CommandedMotion, at_rest, brake, limit_motion, resting_place
from forcemesh.faults import clipped
from forcemesh.messages import Trip, WrenchAtTcp

Reaction = Literal["hold", "fade", "retreat"]

# fmt: off
REACTIONS: dict[str, Reaction] = {
    "workspace":   "fade",
    "tether":      "fade",
    "joint_speed": "fade",
    "regulator":   "fade",
    "travel":      "fade",
    "force":       "retreat",
    "torque":      "retreat",
}
# fmt: on
RETREAT_FROM = 0.8  # of a ceiling, below the robot's own check, which would interrupt it
RETREAT_WITHIN_S = 2.0


class Tick(NamedTuple):
    """One period: measured flange pose, time and length."""

    T_measured: pin.SE3
    now_ns: int
    dt_s: float
    longest_s: float  # a set point that stood for longer has brought the arm to rest
    stamp_ns: int  # of the measured pose, by the robot's clock


class SampleClock(NamedTuple):
    """Time base of the regulator's set points: the stamps of the wrenches that they follow.

    The arbiter wakes up to a period earlier or later than on average. By its own clock a smooth
    motion would accelerate and brake all the time, and the limits would deform it.
    """

    stamp_ns: int  # of the wrench of the last set point
    now_ns: int  # of the arbiter, then
    lead_s: float = 0.0  # of the stamps over the arbiter's clock

    def next(self, stamp_ns: int, now_ns: int, longest_s: float) -> tuple["SampleClock", float]:
        """Return the clock at the next set point, and the time since the last one [s].

        Stamps only run forward, and ahead of the arbiter's clock by `longest_s` at most: wrong ones
        would allow any speed.
        """
        newest_ns = max(stamp_ns, self.stamp_ns)
        gap_s = (newest_ns - self.stamp_ns) / NS_PER_S
        lead_s = max(self.lead_s + gap_s - (now_ns - self.now_ns) / NS_PER_S, -longest_s)
        excess_s = max(lead_s - longest_s, 0.0)
        return SampleClock(newest_ns, now_ns, lead_s - excess_s), max(gap_s - excess_s, 0.0)


def follow(
    motion: CommandedMotion,
    T_target: pin.SE3,
    bounds: ArmBounds,
    tick: Tick,
    *,
    dt_s: float,
    joints: JointStream | None = None,
) -> CommandedMotion | Trip:
    """Return the motion towards a target pose, or the limit that it violates.

    Speed and acceleration of flange and joints are limited; from every accepted set point the arm
    can be braked inside the bounds.

    Args:
        motion: Up to the last set point.
        T_target: Target of the flange in base.
        bounds: Limits of the arm.
        tick: This period.
        dt_s: Time since the last set point; 0 when the target is still the same one.
        joints: Joint angles up to the last set point; None: the arm has no model.
    """
    limits = bounds.limits
    if not is_finite_pose(T_target):
        return check_workspace(limits, T_target) or motion
    if dt_s > tick.longest_s:
        motion, dt_s = at_rest(motion.T_base_flange), tick.longest_s
    after = released(joints, motion, limit_motion(limits, motion, T_target, dt_s), dt_s)
    if isinstance(after, Trip):
        return after
    return (
        bounds.place(resting_place(limits, after))
        or check_apart("step", limits, tick.T_measured, after.T_base_flange)
        or after
    )


def released(
    joints: JointStream | None, before: CommandedMotion, after: CommandedMotion, dt_s: float
) -> CommandedMotion | Trip:
    """Return the motion of a period that the joints can follow, or the limit that it violates."""
    return after if joints is None else joints.follow(before, after, dt_s)


# --- stops ----------------------------------------------------------------------------------------


def retreat_limits(limits: Limits, section: ForceSection) -> Limits:
    """Return limits with the ceilings at which a retreat begins, if it is enabled."""
    if section.retreat_m <= 0.0:
        return limits
    force_N, torque_Nm = RETREAT_FROM * limits.force_N, RETREAT_FROM * limits.torque_Nm
    return replace(limits, force_N=force_N, torque_Nm=torque_Nm)


@dataclass(frozen=True, slots=True)
class Stopping:
    """State of a soft stop: its cause, and the set points that come to rest."""

    trip: Trip
    motion: CommandedMotion
    since_ns: int
    speed_m_s: float = 0.0  # of a retreat
    T_back: pin.SE3 | None = None  # end pose of a retreat; None for a fade
    travel_m: float = 0.0  # travel of a retreat
    done: bool = False
    joints: JointStream | None = None  # advanced with the motion


def begin_stop(
    stopping: Stopping, bounds: ArmBounds, section: ForceSection, wrench: WrenchAtTcp | None
) -> Stopping | None:
    """Return the soft stop for its cause; None when the arm must be held at once.

    A retreat needs a valid wrench that pushes against the press axis.
    """
    reaction, motion = REACTIONS.get(stopping.trip.code), stopping.motion
    if reaction == "fade" and not motion.is_at_rest:
        return stopping
    if reaction != "retreat" or section.retreat_m <= 0.0 or wrench is None:
        return None
    T = motion.T_base_flange
    press_axis = (T * bounds.T_flange_tcp).rotation[:, 2]
    if dot(wrench.force_N, press_axis) >= 0.0:
        return None
    travel_m, speed_m_s = section.retreat_m, section.retreat_m_s
    T_back = pin.SE3(T.rotation, T.translation - travel_m * press_axis)
    return replace(stopping, speed_m_s=speed_m_s, T_back=T_back, travel_m=travel_m)


def step_stop(stopping: Stopping, bounds: ArmBounds, tick: Tick) -> Stopping:
    """Return the stop one period later; at its end the trip contains cause and travel."""
    if stopping.T_back is None:
        before, dt_s = stopping.motion, tick.dt_s
        motion = released(stopping.joints, before, brake(bounds.limits, before, dt_s), dt_s)
        if isinstance(motion, Trip):
            return replace(stopping, done=True)
        return replace(stopping, motion=motion, done=motion.is_at_rest)
    slow = replace(bounds.limits, speed_m_s=stopping.speed_m_s)
    motion = limit_motion(slow, stopping.motion, stopping.T_back, tick.dt_s)
    late = tick.now_ns - stopping.since_ns > RETREAT_WITHIN_S * NS_PER_S
    T_reached = motion.T_base_flange
    is_over = motion.is_at_rest and T_reached is motion.T_target
    done = late or is_over or bounds.place(T_reached)
    if not done:
        return replace(stopping, motion=motion)
    left_m, _ = apart(stopping.motion.T_base_flange, stopping.T_back)
    text = f"{stopping.trip.text}; the tool went back {(stopping.travel_m - left_m) * 1e3:.1f} mm"
    trip = stopping.trip.replaced(text=clipped(text))
    return replace(stopping, trip=trip, done=True)
