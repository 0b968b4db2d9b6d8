"""Motion limits. Pure; used by the arbiter and again by the robot's process.

Every check returns a `Trip` with the rule, the finding, the value and the limit.
"""

from dataclasses import dataclass
from math import degrees, hypot, radians

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig, PlaneSection
from common.motion.frames import (
    Array,
    is_finite,
    is_finite_pose,
    length,
    rotation_between,
    rotation_from_vector,
)
from forcemesh.faults import tripped
from forcemesh.messages import Joints, Trip, Vec3


@dataclass(frozen=True, slots=True)
class Plane:
    """Workspace plane in base axes; the TCP must stay on the side of the normal."""

    point_m: Array
    normal: Array  # of length 1


@dataclass(frozen=True, slots=True)
class Limits:
    """The cell's limits in SI units."""

    workspace_min_m: Array  # of the TCP, base axes
    workspace_max_m: Array
    joint_min_rad: Array
    joint_max_rad: Array
    joint_speed_rad_s: Array
    step_m: float
    step_rad: float
    speed_m_s: float
    speed_rad_s: float
    accel_m_s2: float
    accel_rad_s2: float
    tether_m: float
    tether_rad: float
    force_N: float
    torque_Nm: float
    move_rise_N: float
    planes: tuple[Plane, ...] = ()

    @classmethod
    def of(cls, cell: CellConfig) -> "Limits":
        """Return the limits of a cell file."""
        limits = cell.limits
        return cls(
            workspace_min_m=np.array(limits.workspace_min_m),
            workspace_max_m=np.array(limits.workspace_max_m),
            joint_min_rad=np.radians(cell.robot.joint_min_deg),
            joint_max_rad=np.radians(cell.robot.joint_max_deg),
            joint_speed_rad_s=limits.joint_speed_share
            * np.radians(cell.robot.joint_speed_max_deg_s),
            step_m=limits.step_m,
            step_rad=radians(limits.step_deg),
            speed_m_s=limits.speed_m_s,
            speed_rad_s=radians(limits.speed_deg_s),
            accel_m_s2=limits.accel_m_s2,
            accel_rad_s2=radians(limits.accel_deg_s2),
            tether_m=limits.tether_m,
            tether_rad=radians(limits.tether_deg),
            force_N=limits.force_N,
            torque_Nm=limits.torque_Nm,
            move_rise_N=limits.move_rise_N,
            planes=tuple(_plane(plane) for plane in limits.planes),
        )


def _plane(section: PlaneSection) -> Plane:
    normal = np.array(section.normal)
    return Plane(np.array(section.point_m), normal / length(normal))


def check_workspace(limits: Limits, T_base_tcp: pin.SE3) -> Trip | None:
    """Refuse a TCP outside the box or behind a plane, or a pose that is not finite."""
    if not is_finite_pose(T_base_tcp):
        return _not_finite("the pose")
    p = T_base_tcp.translation
    bounds = (limits.workspace_min_m.tolist(), limits.workspace_max_m.tolist())
    for axis, value, low, high in zip("xyz", p.tolist(), *bounds, strict=True):
        if not low <= value <= high:
            broken = low if value < low else high
            text = f"TCP {axis} = {value * 1e3:.1f} mm is outside the workspace"
            return tripped("workspace", text, value=value, limit=broken, unit="m")
    for number, plane in enumerate(limits.planes, start=1):
        beyond_m = float((plane.point_m - p) @ plane.normal)
        if beyond_m > 0.0:
            text = f"TCP is {beyond_m * 1e3:.1f} mm behind plane {number}"
            return tripped("workspace", text, value=-beyond_m, limit=0.0, unit="m")
    return None


def check_step(limits: Limits, T_from: pin.SE3, T_to: pin.SE3) -> Trip | None:
    """Refuse a set point too far from the robot's pose."""
    if not (is_finite_pose(T_from) and is_finite_pose(T_to)):
        return _not_finite("the set point or the arm's pose")
    distance_m = length(T_to.translation - T_from.translation)
    if distance_m > limits.step_m:
        text = f"set point {distance_m * 1e3:.1f} mm away from the arm"
        return tripped("step", text, value=distance_m, limit=limits.step_m, unit="m")
    angle_rad = length(rotation_between(T_from.rotation, T_to.rotation))
    if angle_rad > limits.step_rad:
        text = f"set point {degrees(angle_rad):.1f} degrees away from the arm"
        return tripped("step", text, value=angle_rad, limit=limits.step_rad, unit="rad")
    return None


def check_tether(limits: Limits, T_start: pin.SE3, T_now: pin.SE3) -> Trip | None:
    """Refuse a flange pose too far from that at which the arm was armed."""
    if not (is_finite_pose(T_start) and is_finite_pose(T_now)):
        return _not_finite("the pose")
    distance_m = length(T_now.translation - T_start.translation)
    if distance_m > limits.tether_m:
        text = f"{distance_m * 1e3:.0f} mm away from the pose at arming"
        return tripped("tether", text, value=distance_m, limit=limits.tether_m, unit="m")
    angle_rad = length(rotation_between(T_start.rotation, T_now.rotation))
    if angle_rad > limits.tether_rad:
        text = (
            f"rotated {degrees(angle_rad):.1f} degrees from the pose at arming, "
            f"limits.tether_deg is {degrees(limits.tether_rad):g}"
        )
        return tripped("tether", text, value=angle_rad, limit=limits.tether_rad, unit="rad")
    return None


def check_joint_count(limits: Limits, joint_rad: Joints | Array) -> Trip | None:
    """Refuse joint angles of another arm: one for each joint of the cell file."""
    count, expected = len(joint_rad), len(limits.joint_min_rad)
    if count == expected:
        return None
    text = f"{count} joint angles, the arm of the cell file has {expected} joints"
    return tripped("joint_count", text, value=count, limit=expected)


def check_joints(
    limits: Limits, joint_rad: Joints | Array, *, slack_rad: float = 0.0
) -> Trip | None:
    """Refuse joint angles outside the arm's range, with a tolerance."""
    if (trip := check_joint_count(limits, joint_rad)) is not None:
        return trip
    if not is_finite(joint_rad):
        return _not_finite("a joint angle")
    bounds = (limits.joint_min_rad.tolist(), limits.joint_max_rad.tolist())
    for number, (angle, lowest, highest) in enumerate(zip(joint_rad, *bounds, strict=True), 1):
        low, high = lowest - slack_rad, highest + slack_rad
        if not low <= angle <= high:
            broken = low if angle < low else high
            text = f"joint {number} = {degrees(angle):.1f} degrees is out of its range"
            return tripped("joint", text, value=float(angle), limit=broken, unit="rad")
    return None


def check_joint_speed(limits: Limits, speed_rad_s: Array) -> Trip | None:
    """Refuse joint speeds above the limit. Shape (6,)."""
    speeds = [abs(speed) for speed in speed_rad_s.tolist()]
    if not is_finite(speeds):
        return _not_finite("a joint's speed")
    fastest_rad_s = limits.joint_speed_rad_s.tolist()
    for number, (speed, fastest) in enumerate(zip(speeds, fastest_rad_s, strict=True), start=1):
        if speed > fastest:
            text = f"joint {number} turns at {degrees(speed):.0f} degrees/s"
            return tripped("joint_speed", text, value=speed, limit=fastest, unit="rad/s")
    return None


def check_wrench(limits: Limits, force_N: Vec3 | Array, torque_Nm: Vec3 | Array) -> Trip | None:
    """Refuse a wrench above the force or torque ceiling."""
    if not (is_finite(force_N) and is_finite(torque_Nm)):
        return _not_finite("the wrench")
    force = hypot(*force_N)
    if force > limits.force_N:
        text = f"force {force:.1f} N is above the ceiling"
        return tripped("force", text, value=force, limit=limits.force_N, unit="N")
    torque = hypot(*torque_Nm)
    if torque > limits.torque_Nm:
        text = f"torque {torque:.2f} N m is above the ceiling"
        return tripped("torque", text, value=torque, limit=limits.torque_Nm, unit="N m")
    return None


def limit_speed(limits: Limits, T_from: pin.SE3, T_to: pin.SE3, dt_s: float) -> pin.SE3:
    """Return the pose on the path to `T_to` that the speed limits allow after `dt_s`.

    A target that is not finite is returned unchanged, for `check_workspace` to refuse.
    """
    if not is_finite_pose(T_to):
        return T_to
    step_m = T_to.translation - T_from.translation
    turn_rad = rotation_between(T_from.rotation, T_to.rotation)
    scale_m = _scale(length(step_m), limits.speed_m_s * dt_s)
    scale_rad = _scale(length(turn_rad), limits.speed_rad_s * dt_s)
    if scale_m == 1.0 and scale_rad == 1.0:
        return T_to
    R = rotation_from_vector(turn_rad * scale_rad) @ T_from.rotation
    return pin.SE3(R, T_from.translation + step_m * scale_m)


def _scale(size: float, longest: float) -> float:
    return 1.0 if size <= longest else longest / size


def _not_finite(what: str) -> Trip:
    return tripped("not_finite", f"{what} holds a number that is not finite")
