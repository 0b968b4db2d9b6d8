"""Planner from motion requests to segments; reachability is tested before the motion starts."""

import math
from functools import lru_cache

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, rotation_between, rotation_from_vector
from common.motion.kinematics import ArmKinematics, IkResult
from common.motion.paths import TURN_RADIUS_M, JointPath
from sim.as_language.errors import AsError
from sim.controller.motion_requests import (
    BRAKE_FACTOR,
    JOINT_ACCEL_TIME_S,
    LINEAR_ACCEL_M_S2,
    LINEAR_MAX_M_S,
    MotionRequest,
)
from sim.controller.segment import Ramp, Segment

_LEAST_EXTENT = 1e-9
_ZERO_LENGTH = Ramp(1.0, 1.0, 1.0, 1.0)  # of a motion of zero length
_WHOLE_TURN_RAD = 2.0 * np.pi
# Further start values of the inverse kinematics if it fails from the current joints [deg]: JT1
# and JT5 decide the branch, so these few cover all branches.
_STARTS_DEG = tuple(
    (jt1, jt2, jt3, 0.0, jt5, 0.0)
    for jt1 in (0.0, 90.0, -90.0, 170.0)
    for jt2, jt3 in ((0.0, -90.0), (45.0, -45.0))
    for jt5 in (-60.0, 60.0)
)
JUMP_RAD = 0.6  # between two samples; a larger change means another kinematic branch
_SAMPLE_M = 0.01
_SAMPLES = (4, 200)


def plan(kinematics: ArmKinematics, motion: MotionRequest, q_from: Array) -> Segment:
    """Return the segment of a motion that starts at q_from [rad].

    Raises AsError: E6007, E6008, E6016 if the target or its path cannot be reached.
    """
    if motion.kind == "linear":
        return _linear(kinematics, motion, q_from)
    q_to = joint_target(kinematics, motion, q_from)
    return _joint(kinematics, motion, q_from=q_from, q_to=q_to)


def joint_target(kinematics: ArmKinematics, motion: MotionRequest, q_near: Array) -> Array:
    """Return the joint angles [rad] at the end of a motion, near `q_near`.

    Raises AsError: E6007, E6008, E6016 if the target cannot be reached.
    """
    if motion.q is not None:
        violation = kinematics.limit_violation(motion.q)
        if violation:
            raise AsError("E6007", violation)
        return motion.q
    if motion.T_base_tcp is None:
        return q_near
    goal = motion.T_base_tcp
    if motion.manner.T_flange_tcp is not None:
        goal = goal * motion.manner.T_flange_tcp.inverse()
    result = inverse(kinematics, goal, q_near)
    if result.q is None:
        raise reach_error(result.reason)
    return result.q


def inverse(kinematics: ArmKinematics, T_base_flange: pin.SE3, q_near: Array) -> IkResult:
    """Return joint angles for a pose: on the branch of q_near, else the nearest solution found."""
    return _inverse(kinematics, T_base_flange.homogeneous.tobytes(), q_near.tobytes())


@lru_cache(maxsize=4)  # INRANGE and the motion after it request the same solution
def _inverse(kinematics: ArmKinematics, pose_bytes: bytes, q_bytes: bytes) -> IkResult:
    T_base_flange = pin.SE3(np.frombuffer(pose_bytes).reshape(4, 4))
    q_near = np.frombuffer(q_bytes)
    first = kinematics.solve(T_base_flange, q_near, jump_rad=_WHOLE_TURN_RAD)
    if first.q is not None or "out of reach" in first.reason:
        return first
    found: list[Array] = []
    for start in _STARTS_DEG:
        result = kinematics.solve(T_base_flange, np.radians(start), jump_rad=_WHOLE_TURN_RAD)
        if result.q is not None:
            found.append(result.q)
    if not found:
        return first
    return IkResult(min(found, key=lambda q: float(np.abs(q - q_near).max())))


def reach_error(reason: str) -> AsError:
    """Return the AS error for an error text of the kinematics.

    E6007: beyond the reach of the arm or a joint limit; E6016: singular pose; E6008: reachable
    only in another posture.
    """
    if "limits are" in reason or "out of reach" in reason:
        return AsError("E6007", reason)
    return AsError("E6016" if "singular" in reason else "E6008", reason)


def _linear(kinematics: ArmKinematics, motion: MotionRequest, q_from: Array) -> Segment:
    tool = motion.manner.T_flange_tcp or pin.SE3.Identity()
    T_from = kinematics.flange_pose(q_from) * tool
    T_to = motion.T_base_tcp
    if T_to is None:
        T_to = kinematics.flange_pose(joint_target(kinematics, motion, q_from)) * tool
    line = TcpLine(kinematics, T_flange_tcp=tool, T_from=T_from, T_to=T_to)
    if line.extent_m < _LEAST_EXTENT:
        return Segment(line, _ZERO_LENGTH, q_from=q_from, q_to=q_from)
    end = line.walk(q_from)
    if end.q is None:
        raise reach_error(end.reason)
    extent, manner = line.extent_m, motion.manner
    per_extent = LINEAR_ACCEL_M_S2 / extent
    ramp = Ramp(
        cap=min(manner.speed.linear_m_s(extent), LINEAR_MAX_M_S) / extent,
        accel=manner.accel_fraction * per_extent,
        decel=manner.decel_fraction * per_extent,
        brake=BRAKE_FACTOR * per_extent,
    )
    return Segment(line, ramp, q_from=q_from, q_to=end.q)


def _joint(
    kinematics: ArmKinematics, motion: MotionRequest, *, q_from: Array, q_to: Array
) -> Segment:
    full_speed_s = float((np.abs(q_to - q_from) / kinematics.max_speed_rad_s).max())
    path, manner = JointPath(kinematics, q_from, q_to), motion.manner
    if full_speed_s < _LEAST_EXTENT:
        return Segment(path, _ZERO_LENGTH, q_from=q_from, q_to=q_from)
    # The manual's 100 % ramps take every joint to its full speed in the same time. The flange
    # also stays within the linear ramp, which limits the acceleration of the tool.
    full_accel = min(
        1.0 / JOINT_ACCEL_TIME_S / full_speed_s, 5.0 * LINEAR_ACCEL_M_S2 / path.extent_m
    )
    ramp = Ramp(
        cap=manner.speed.joint_fraction(full_speed_s) / full_speed_s,
        accel=manner.accel_fraction * full_accel,
        decel=manner.decel_fraction * full_accel,
        brake=BRAKE_FACTOR * full_accel,
    )
    return Segment(path, ramp, q_from=q_from, q_to=q_to)


class TcpLine:
    """Linear TCP path with uniform rotation about one fixed axis; path parameter in 0..1."""

    def __init__(
        self, kinematics: ArmKinematics, *, T_flange_tcp: pin.SE3, T_from: pin.SE3, T_to: pin.SE3
    ) -> None:
        """Set the TCP's pose at both ends, in the robot's base frame."""
        self.kinematics = kinematics
        self._T_tcp_flange = T_flange_tcp.inverse()
        self._from, self._to = T_from, T_to
        self._travel_m = T_to.translation - T_from.translation
        self._rotation = rotation_between(T_from.rotation, T_to.rotation)
        self.travel_m = float(np.linalg.norm(self._travel_m))
        self.extent_m = max(self.travel_m, TURN_RADIUS_M * float(np.linalg.norm(self._rotation)))

    def tcp(self, share: float) -> pin.SE3:
        """Return T_base_tcp at path parameter `share`; the end is exact."""
        if share >= 1.0:
            return self._to
        return pin.SE3(
            rotation_from_vector(share * self._rotation) @ self._from.rotation,
            self._from.translation + share * self._travel_m,
        )

    def at(self, share: float, q_near: np.ndarray) -> IkResult:
        """Return the joint angles at path parameter `share`, on the branch of q_near."""
        T_base_flange = self.tcp(share) * self._T_tcp_flange
        return self.kinematics.solve(T_base_flange, q_near, jump_rad=JUMP_RAD)

    def walk(self, q_from: np.ndarray) -> IkResult:
        """Check the whole path; return the joints at its end, or why it cannot be followed."""
        count = min(max(_SAMPLES[0], math.ceil(self.extent_m / _SAMPLE_M)), _SAMPLES[1])
        q = q_from
        for k in range(1, count + 1):
            result = self.at(k / count, q)
            if result.q is None:
                return IkResult(None, f"after {100 * k // count} % of the path: {result.reason}")
            q = result.q
        return IkResult(q)
