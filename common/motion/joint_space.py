"""Check of streamed set points in joint space, by one step of inverse kinematics for each. Pure.

Near a singularity a small motion of the flange turns joints far. The speed of the flange is
therefore limited to that at which no joint would exceed its limit, in whichever direction the
flange moves; below `LEAST_M_S` only the present direction counts, so that a singularity can be
passed and left. Elsewhere a set point is released as it is. A set point that would leave a joint's
range, or that no joint angles reach, is refused with the joint, the value and the limit.

The joint angles are those of the commands, from the measured ones at the start of the stream on.
The model's error at that place, which every real arm has, is kept as a constant.
"""

from dataclasses import replace
from math import degrees, hypot, inf, radians, sqrt
from operator import sub, truediv

import numpy as np
import pinocchio as pin

from common.config.arm import UNKNOWN_ARM
from common.config.cell import CellConfig
from common.motion.frames import Array, Speeds, apart
from common.motion.kinematics import ArmKinematics
from common.motion.limits import Limits, check_joints
from common.motion.paths import TURN_RADIUS_M
from common.motion.rate_limiter import (
    REST,
    SAME_INSTANT_S,
    CommandedMotion,
    half_braking_s,
    slowed,
)
from forcemesh.faults import tripped
from forcemesh.messages import Joints, Trip

SPEED_SHARE = 0.8  # of limits.joint_speed_share: the measured joints stay below that limit
LEAST_M_S = 0.001  # speed of the flange from which a singularity slows it in every direction
# No data sheet here has accelerations: each joint reaches its full speed in this time.
FULL_SPEED_S = 0.125
JOINT_ACCEL_MARGIN = 1.5  # over that, where slowing alone cannot keep it: refused above
MISFIT_M, MISFIT_RAD = 0.005, radians(1.0)  # of an arm and its model: TOOL, BASE or another arm
NEAR_M_S = 0.05  # such a free speed is near a singularity: joint angles are iterated there
LONGEST_TURN_RAD = 0.35  # of a joint in one period, near a singularity
JOINT_MARGIN = 1.05  # of a joint's speed where the share is reckoned from one step
# Squared size of a twist: a rotation counts by the travel at the radius.
_WEIGHTS = np.array([1.0] * 3 + [TURN_RADIUS_M**-2] * 3)


class JointSpace:
    """Model and joint limits of a cell's arm."""

    def __init__(self, cell: CellConfig, arm: ArmKinematics) -> None:
        """Store the limits; every stream begins with `begin`."""
        self.name = cell.robot.model
        self.arm = arm
        self.limits = Limits.of(cell)
        self.speed_rad_s: Array = SPEED_SHARE * self.limits.joint_speed_rad_s
        self.accel_rad_s2: Array = np.radians(cell.robot.joint_speed_max_deg_s) / FULL_SPEED_S

        # Below this product of speed and gain no joint is at its limit, whatever the direction.
        self.far = float(self.speed_rad_s.min()) / sqrt(_WEIGHTS.max())

    @classmethod
    def of(cls, cell: CellConfig) -> "JointSpace | None":
        """Return the joint space of a cell's arm, None if the arm has no model."""
        if cell.robot.model == UNKNOWN_ARM:
            return None
        return cls(cell, ArmKinematics(cell.robot.model))

    def misfit(self, T_measured: pin.SE3, joint_rad: Joints | Array) -> str:
        """Return why the model does not describe the measured arm, empty when it does."""
        if len(joint_rad) != self.arm.joints:
            return f"{len(joint_rad)} joint angles, arms/{self.name} has {self.arm.joints} joints"
        away_m, turned_rad = apart(self.arm.flange_pose(np.array(joint_rad)), T_measured)
        if away_m <= MISFIT_M and turned_rad <= MISFIT_RAD:
            return ""
        return (
            f"the measured pose is {1e3 * away_m:.1f} mm and {degrees(turned_rad):.1f} degrees "
            f"from that of arms/{self.name} at these joint angles"
        )

    def begin(self, T_measured: pin.SE3, joint_rad: Joints | Array) -> "JointStream | None":
        """Return a stream that begins at the measured arm, None if the model does not fit it."""
        return (
            None if self.misfit(T_measured, joint_rad) else JointStream(self, T_measured, joint_rad)
        )

    def ranges_from(self, q: Array) -> Limits:
        """Return the limits with joint ranges that contain q: from outside, a joint may return."""
        low, high = self.limits.joint_min_rad, self.limits.joint_max_rad
        return replace(
            self.limits, joint_min_rad=np.minimum(low, q), joint_max_rad=np.maximum(high, q)
        )

    def free_m_s(self, inverse: Array) -> float:
        """Return the speed of the flange up to which no joint exceeds its limit, in any direction.

        Args:
            inverse: Inverse of the Jacobian. Shape (n, 6).
        """
        gains = np.square(inverse).dot(_WEIGHTS) / np.square(self.speed_rad_s)
        return 1.0 / sqrt(gains.max())

    def speed_trip(self, speed_rad_s: Array) -> Trip:
        """Return the trip of the joint that is too fast by the largest factor. Shape (n,)."""
        joint = int(abs(speed_rad_s / self.speed_rad_s).argmax())
        value, limit = float(abs(speed_rad_s[joint])), float(self.speed_rad_s[joint])
        text = f"joint {joint + 1} would turn at {degrees(value):.0f} degrees/s"
        return tripped("joint_speed", text, value=value, limit=limit, unit="rad/s")

    def acceleration_trip(self, change_rad_s: Array, dt_s: float) -> Trip | None:
        """Refuse a change of the joint speeds in a period. Shape (n,)."""
        accel_rad_s2, most = abs(change_rad_s) / dt_s, JOINT_ACCEL_MARGIN * self.accel_rad_s2
        if (accel_rad_s2 <= most).all():
            return None
        joint = int((accel_rad_s2 / most).argmax())
        value, limit = float(accel_rad_s2[joint]), float(most[joint])
        text = f"joint {joint + 1} would accelerate by {degrees(value):.0f} degrees/s^2"
        return tripped("acceleration", text, value=value, limit=limit, unit="rad/s^2")


class JointStream:
    """Joint angles of a stream of set points."""

    def __init__(self, space: JointSpace, T_measured: pin.SE3, joint_rad: Joints | Array) -> None:
        """Begin at rest at the measured pose and joint angles."""
        self._space = space
        self.q: Array = np.array(joint_rad)
        self.speed_rad_s: Array = np.zeros(len(self.q))
        self._T_flange_model = T_measured.actInv(space.arm.flange_pose(self.q))
        self._limits = space.ranges_from(self.q)
        self._fastest_rad_s: list[float] = space.speed_rad_s.tolist()
        self._accel_rad_s2: list[float] = space.accel_rad_s2.tolist()

    def follow(
        self, before: CommandedMotion, after: CommandedMotion, dt_s: float
    ) -> CommandedMotion | Trip:
        """Return the motion of a period, slowed near a singularity, or the limit it violates.

        A motion within the limits is returned as the same object.

        Args:
            before: The motion up to the last set point.
            after: The next one, within the limits of the flange.
            dt_s: Time in between.
        """
        if dt_s < SAME_INSTANT_S:
            return after
        space = self._space
        if before.speeds is REST:  # the stream paused
            self.speed_rad_s = np.zeros(len(self.q))
        T_model = after.T_base_flange * self._T_flange_model
        step = space.arm.step_towards(T_model, self.q)
        speed_rad_s = step.inverse.dot(step.twist) / dt_s
        flange_m_s = _size_m(after.speeds)
        resting_s = dt_s + half_braking_s(self._limits, after.speeds)
        fast_m_s, free_m_s = max(flange_m_s, NEAR_M_S), inf
        if fast_m_s * step.gain > space.far:
            free_m_s = 0.0 if step.is_damped else space.free_m_s(step.inverse)
        if fast_m_s <= free_m_s and self._is_followed(speed_rad_s.tolist(), dt_s):
            trip = check_joints(self._limits, (self.q + resting_s * speed_rad_s).tolist())
            if trip is None:
                self.q, self.speed_rad_s = self.q + dt_s * speed_rad_s, speed_rad_s
            return trip or after
        share = self._share(flange_m_s, free_m_s, speed_rad_s, dt_s)
        trip = check_joints(self._limits, self.q + share * resting_s * speed_rad_s)
        return trip or self._solved(before, after, share, dt_s)

    def _is_followed(self, speeds_rad_s: list[float], dt_s: float) -> bool:
        """Return whether every joint keeps its speed and acceleration."""
        changes = map(sub, speeds_rad_s, self.speed_rad_s.tolist())
        harshest: float = max(map(truediv, map(abs, changes), self._accel_rad_s2))
        fastest: float = max(map(truediv, map(abs, speeds_rad_s), self._fastest_rad_s))
        return fastest <= 1.0 and harshest <= dt_s

    def _share(self, flange_m_s: float, free_m_s: float, speed_rad_s: Array, dt_s: float) -> float:
        """Return the share of the flange's speed at which all joints keep their limits."""
        space, share = self._space, 1.0
        if flange_m_s > free_m_s:
            share = min(max(free_m_s, LEAST_M_S) / flange_m_s, 1.0)
        fastest = float(abs(speed_rad_s / space.speed_rad_s).max())
        if share * fastest > 1.0:
            share = 1.0 / fastest
        most_rad_s = dt_s * space.accel_rad_s2
        if (abs(share * speed_rad_s - self.speed_rad_s) <= most_rad_s).all():
            return share
        turns = speed_rad_s != 0.0
        ahead = (self.speed_rad_s * np.sign(speed_rad_s) + most_rad_s)[turns]
        return min(share, max(float((ahead / abs(speed_rad_s[turns])).min()), 0.0))

    def _solved(
        self, before: CommandedMotion, after: CommandedMotion, share: float, dt_s: float
    ) -> CommandedMotion | Trip:
        """Return the motion at a share of its speed, by iterated inverse kinematics.

        One step is not exact enough where the Jacobian changes within a period.
        """
        space, trips = self._space, list[Trip]()
        for tried in (share, 0.5 * share, 0.25 * share):
            motion = after if tried == 1.0 else slowed(after, before, tried, dt_s)
            T_model = motion.T_base_flange * self._T_flange_model
            q, reason = space.arm.solve(T_model, self.q, jump_rad=LONGEST_TURN_RAD)
            if q is None:
                trips.append(tripped("unreachable", f"the arm cannot follow: {reason}"))
                continue
            speed_rad_s = (q - self.q) / dt_s
            late = space.acceleration_trip(speed_rad_s - self.speed_rad_s, dt_s)
            if late is None and (abs(speed_rad_s) <= JOINT_MARGIN * space.speed_rad_s).all():
                self.q, self.speed_rad_s = q, speed_rad_s
                return motion
            trips.append(late or space.speed_trip(speed_rad_s))
        return trips[0]


def _size_m(speeds: Speeds) -> float:
    """Return one size [m/s] of speeds: a rotation counts by the travel at a radius."""
    v, w = speeds
    return hypot(*v, TURN_RADIUS_M * hypot(*w))


def checks_off_text(
    space: JointSpace | None, T_measured: pin.SE3, joint_rad: Joints | Array
) -> str:
    """Return a note that joints are not checked ahead, and why; empty when they are."""
    why = f"robot.model is {UNKNOWN_ARM}" if space is None else space.misfit(T_measured, joint_rad)
    return f"; joints are not checked ahead: {why}" if why else ""
