"""Planner from motion requests to segments; reachability is tested before the motion starts.

A segment is one motion with a trapezoidal speed profile along a path, stepped per tick. The path
parameter s follows ds/dt = rate. The rate rises with `accel`, is capped by program speed times
monitor speed, and falls to zero at the end of the path (the discrete ramp of sim.robot.motion).
HOLD caps the rate at zero; BRAKE does too and ends the segment.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, apart, interpolated
from common.motion.kinematics import ArmKinematics, IkResult
from common.motion.paths import TURN_RADIUS_M, JointPath, MotionPath
from sim.as_language.errors import AsError
from sim.controller.motion_requests import (
    BRAKE_FACTOR,
    JOINT_ACCEL_TIME_S,
    LINEAR_ACCEL_M_S2,
    LINEAR_MAX_M_S,
    MotionParameters,
    MotionRequest,
)
from sim.robot.motion import step_along

_LEAST_EXTENT = 1e-9
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
_SHORTEST = 1e-9
_WRIST = 4  # JT5
_LEAST_ARC = 1e-4  # sine of the angle at the first of three points of a circle


class Ramp(NamedTuple):
    """Rates of a segment per unit of its extent: cap [1/s], accel, decel, brake [1/s^2].

    `absolute_below` is the rate of full speed where the monitor speed scales only that (ABS.SPEED),
    else 0.
    """

    cap: float
    accel: float
    decel: float
    brake: float
    absolute_below: float = 0.0

    def fed(self, feed: float) -> float:
        """Return the cap at a monitor speed, as a fraction [1/s]."""
        return min(self.cap, self.absolute_below * feed) if self.absolute_below else self.cap * feed


class Segment:
    """Motion between two points. `q` is the current joint position of this segment."""

    def __init__(self, path: MotionPath, ramp: Ramp, *, q_from: Array, q_to: Array) -> None:
        """Start at the beginning of the path with rate zero. Shapes (6,)."""
        self.path, self.ramp = path, ramp
        self.q_from, self.q_to = q_from, q_to
        self.q: Array = q_from
        self.rate = 0.0
        self.slowing = False  # deceleration at the end of the path has begun
        self.braking = False
        self.done = bool(np.abs(q_to - q_from).max() < _SHORTEST)
        self.share = float(self.done)

    @property
    def covered(self) -> Array:
        """Joint displacement so far [rad]. Shape (6,)."""
        return self.q - self.q_from

    def planned_s(self, feed: float) -> float:
        """Return the duration at program speed times monitor speed, without ramps [s]."""
        return 1.0 / self.ramp.fed(feed)

    def tick(self, dt_s: float, feed: float) -> None:
        """Advance; `feed` is the monitor speed as a fraction, zero while held.

        Raises AsError E6016 if the path cannot be continued: singular pose.
        """
        self.rate = self._next_rate(dt_s, 0.0 if self.braking else feed)
        if self.rate <= 0.0:
            self.done = self.done or self.braking
            return
        step = self.rate * dt_s
        share, result = step_along(self.path, self.share, self.q, step=step, dt_s=dt_s)
        if result.q is None:
            self.rate, self.braking, self.done = 0.0, True, True
            percent = 100 * self.share
            raise AsError("E6016", f"after {percent:.0f} % of the path: {result.reason}")
        self.rate = (share - self.share) / dt_s
        self.share, self.q = share, result.q
        if share >= 1.0:
            self.q, self.done = self.q_to, True

    def _next_rate(self, dt_s: float, feed: float) -> float:
        ramp = self.ramp
        half = 0.5 * ramp.decel * dt_s
        stopping = max(math.sqrt(half * half + 2.0 * ramp.decel * (1.0 - self.share)) - half, half)
        faster = self.rate + ramp.accel * dt_s
        capped = max(ramp.fed(feed), self.rate - ramp.brake * dt_s)
        self.slowing = stopping <= min(faster, capped)
        return max(0.0, min(faster, capped, stopping))


_ZERO_LENGTH = Ramp(1.0, 1.0, 1.0, 1.0)  # of a motion of zero length


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
    goal = motion.T_base_tcp * motion.manner.T_flange_tcp.inverse()
    return inverse(kinematics, goal, q_near)


def inverse(kinematics: ArmKinematics, T_base_flange: pin.SE3, q_near: Array) -> Array:
    """Return joint angles for a pose: on the branch of q_near, else the nearest solution found.

    Raises AsError: E6007, E6008, E6016 if there is none.
    """
    result = _inverse(kinematics, T_base_flange.homogeneous.tobytes(), q_near.tobytes())
    if result.q is None:
        raise reach_error(result.reason)
    return result.q


@lru_cache(maxsize=4)  # INRANGE and the motion after it request the same solution
def _inverse(kinematics: ArmKinematics, pose_bytes: bytes, q_bytes: bytes) -> IkResult:
    T_base_flange = pin.SE3(np.frombuffer(pose_bytes).reshape(4, 4))
    q_near = np.frombuffer(q_bytes)
    first = kinematics.solve(T_base_flange, q_near, jump_rad=_WHOLE_TURN_RAD)
    if first.q is not None or "out of reach" in first.reason:
        return first
    results = (
        kinematics.solve(T_base_flange, np.radians(start), jump_rad=_WHOLE_TURN_RAD)
        for start in _STARTS_DEG
    )
    found = [result.q for result in results if result.q is not None]
    q = min(found, key=lambda q: float(np.abs(q - q_near).max()), default=None)
    return first if q is None else IkResult(q)


def reach_error(reason: str) -> AsError:
    """Return the AS error for an error text of the kinematics.

    E6007: beyond the reach of the arm or a joint limit; E6016: singular pose; E6008: reachable
    only in another posture.
    """
    if "limits are" in reason or "out of reach" in reason:
        return AsError("E6007", reason)
    return AsError("E6016" if "singular" in reason else "E6008", reason)


def _linear(kinematics: ArmKinematics, motion: MotionRequest, q_from: Array) -> Segment:
    tool = motion.manner.T_flange_tcp
    T_from = kinematics.flange_pose(q_from) * tool
    T_to = motion.T_base_tcp
    if T_to is None:
        T_to = kinematics.flange_pose(joint_target(kinematics, motion, q_from)) * tool
    if motion.circle_m is None:
        line = TcpLine(kinematics, T_flange_tcp=tool, T_from=T_from, T_to=T_to)
    else:
        line = TcpArc(
            kinematics, T_flange_tcp=tool, T_from=T_from, T_to=T_to, other_m=motion.circle_m
        )
    if line.extent_m < _LEAST_EXTENT:
        return Segment(line, _ZERO_LENGTH, q_from=q_from, q_to=q_from)
    q_to = line.walk(q_from, motion.manner.straight_wrist_rad)
    if motion.manner.keeps_configuration and motion.q is not None:
        _refuse_other_configuration(q_to, motion.q)
    longest = LINEAR_MAX_M_S / line.extent_m
    cap = min(1.0 / motion.manner.speed.linear_s(line.travel_m, line.turn_rad), longest)
    ramp = _ramp(motion.manner, cap, LINEAR_ACCEL_M_S2 / line.extent_m)
    if motion.manner.absolute:
        ramp = ramp._replace(absolute_below=longest)
    return Segment(line, ramp, q_from=q_from, q_to=q_to)


def _refuse_other_configuration(q_to: Array, q_asked: Array) -> None:
    """Raise AsError E1184 if a path does not end in the joint angles that were asked for."""
    if np.abs(q_to - q_asked).max() > JUMP_RAD:
        raise AsError("E1184", "the target is in another configuration, and CONF_VARIABLE is OFF")


def _joint(
    kinematics: ArmKinematics, motion: MotionRequest, *, q_from: Array, q_to: Array
) -> Segment:
    full_speed_s = kinematics.full_speed_s(q_to - q_from)
    path = JointPath(kinematics, q_from, q_to)
    if full_speed_s < _LEAST_EXTENT:
        return Segment(path, _ZERO_LENGTH, q_from=q_from, q_to=q_from)
    # The manual's 100 % ramps take every joint to its full speed in the same time. The flange
    # also stays within the linear ramp, which limits the acceleration of the tool.
    full_accel = min(
        1.0 / JOINT_ACCEL_TIME_S / full_speed_s, 5.0 * LINEAR_ACCEL_M_S2 / path.extent_m
    )
    cap = motion.manner.speed.joint_fraction(full_speed_s) / full_speed_s
    return Segment(path, _ramp(motion.manner, cap, full_accel), q_from=q_from, q_to=q_to)


def _ramp(manner: MotionParameters, cap: float, full_accel: float) -> Ramp:
    ramp_accel = min(full_accel, cap / manner.accel_time_s) if manner.accel_time_s else full_accel
    return Ramp(
        cap=cap,
        accel=manner.accel_fraction * ramp_accel,
        decel=manner.decel_fraction * ramp_accel,
        brake=BRAKE_FACTOR * full_accel,
    )


class TcpLine:
    """Linear TCP path with uniform rotation about one fixed axis; path parameter in 0..1."""

    def __init__(
        self, kinematics: ArmKinematics, *, T_flange_tcp: pin.SE3, T_from: pin.SE3, T_to: pin.SE3
    ) -> None:
        """Set the TCP's pose at both ends, in the robot's base frame."""
        self.kinematics = kinematics
        self._T_tcp_flange = T_flange_tcp.inverse()
        self._from, self._to = T_from, T_to
        self.travel_m, self.turn_rad = apart(T_from, T_to)
        self.extent_m = max(self.travel_m, TURN_RADIUS_M * self.turn_rad)

    def at(self, share: float, q_near: Array) -> IkResult:
        """Return the joint angles at path parameter `share`, near q_near; the end is exact."""
        T_base_tcp = self._pose(share) if share < 1.0 else self._to
        return self.kinematics.solve(T_base_tcp * self._T_tcp_flange, q_near, jump_rad=JUMP_RAD)

    def _pose(self, share: float) -> pin.SE3:
        return interpolated(self._from, self._to, share)

    def walk(self, q_from: Array, straight_wrist_rad: float = 0.0) -> Array:
        """Check the whole path; return the joints at its end.

        Raises AsError as `inverse`, and E6007 where JT5 is closer to zero than a limit.
        """
        count = min(max(_SAMPLES[0], math.ceil(self.extent_m / _SAMPLE_M)), _SAMPLES[1])
        q = q_from
        for k in range(1, count + 1):
            result = self.at(k / count, q)
            if result.q is None:
                raise reach_error(f"after {100 * k // count} % of the path: {result.reason}")
            q = result.q
            if abs(q[_WRIST]) < straight_wrist_rad:
                angle = f"JT5 at {math.degrees(q[_WRIST]):.1f} deg after {100 * k // count} %"
                raise AsError("E6007", f"{angle} of the path: the wrist is straight (SINGULAR)")
        return q


class TcpArc(TcpLine):
    """Circular TCP path with uniform rotation; path parameter in 0..1."""

    def __init__(
        self,
        kinematics: ArmKinematics,
        *,
        T_flange_tcp: pin.SE3,
        T_from: pin.SE3,
        T_to: pin.SE3,
        other_m: Array,
    ) -> None:
        """Set the ends, and a point of the circle outside of the arc [m]. Shape (3,).

        Raises AsError E1099 if the three points are on a line.
        """
        super().__init__(kinematics, T_flange_tcp=T_flange_tcp, T_from=T_from, T_to=T_to)
        start_m, end_m = T_from.translation, T_to.translation
        self._center_m = circle_center_m(start_m, end_m, other_m)
        self._x = start_m - self._center_m
        self._y = np.cross(_unit(np.cross(end_m - start_m, other_m - start_m)), self._x)
        end_rad, other_rad = self._angle_rad(end_m), self._angle_rad(other_m)
        self._turn_rad = end_rad if end_rad < other_rad else end_rad - _WHOLE_TURN_RAD
        self.travel_m = abs(self._turn_rad) * float(np.linalg.norm(self._x))
        self.extent_m = max(self.extent_m, self.travel_m)

    def _angle_rad(self, point_m: Array) -> float:
        """Return the angle of a point of the circle from the start, in 0 .. 2 pi."""
        off = point_m - self._center_m
        return math.atan2(float(off @ self._y), float(off @ self._x)) % _WHOLE_TURN_RAD

    def _pose(self, share: float) -> pin.SE3:
        angle = share * self._turn_rad
        T = super()._pose(share)
        point_m = self._center_m + math.cos(angle) * self._x + math.sin(angle) * self._y
        return pin.SE3(T.rotation, point_m)


def circle_center_m(a: Array, b: Array, c: Array) -> Array:
    """Return the center of the circle through three points [m]. Shapes (3,).

    Raises AsError E1099 if two are equal, or all are on a line.
    """
    u, v = b - a, c - a
    normal = np.cross(u, v)
    area = float(normal @ normal)
    if area < _LEAST_ARC**2 * float(u @ u) * float(v @ v) or area < _LEAST_EXTENT**4:
        raise AsError("E1099", "the three points of the circle are on a line")
    toward = float(u @ u) * np.cross(v, normal) - float(v @ v) * np.cross(u, normal)
    return a + toward / (2.0 * area)


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)
