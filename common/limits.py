"""What motion is let through at most. Pure; used by the arbiter and again by the robot's process.

Every rule answers with a `Trip` that names the rule, what was found and the number that it broke.
"""

from dataclasses import dataclass
from math import radians

import numpy as np
import pinocchio as pin

from common.cell import Cell
from common.frames import Array, is_finite_pose, rotation_between, rotation_from_vector
from common.messages import Trip, Vec6


@dataclass(frozen=True, slots=True)
class Limits:
    """The cell's limits in SI units."""

    workspace_min_m: Array  # of the TCP, base axes
    workspace_max_m: Array
    joint_min_rad: Array
    joint_max_rad: Array
    step_m: float
    step_rad: float
    speed_m_s: float
    speed_rad_s: float
    tether_m: float
    force_N: float
    torque_Nm: float

    @classmethod
    def of(cls, cell: Cell) -> "Limits":
        """Take the limits out of a cell file."""
        limits = cell.limits
        return cls(
            workspace_min_m=np.array(limits.workspace_min_m),
            workspace_max_m=np.array(limits.workspace_max_m),
            joint_min_rad=np.radians(cell.robot.joint_min_deg),
            joint_max_rad=np.radians(cell.robot.joint_max_deg),
            step_m=limits.step_m,
            step_rad=radians(limits.step_deg),
            speed_m_s=limits.speed_m_s,
            speed_rad_s=radians(limits.speed_deg_s),
            tether_m=limits.tether_m,
            force_N=limits.force_N,
            torque_Nm=limits.torque_Nm,
        )


def check_workspace(limits: Limits, T_base_tcp: pin.SE3) -> Trip | None:
    """Refuse a TCP outside the box, or a pose that is not finite."""
    if not is_finite_pose(T_base_tcp):
        return Trip(code="not_finite", text="the pose holds a number that is not finite")
    p = T_base_tcp.translation
    bounds = (limits.workspace_min_m, limits.workspace_max_m)
    for axis, value, low, high in zip("xyz", p, *bounds, strict=True):
        if not low <= value <= high:
            broken = low if value < low else high
            text = f"TCP {axis} = {value * 1e3:.1f} mm is outside the workspace"
            return Trip(code="workspace", text=text, value=float(value), limit=float(broken))
    return None


def check_step(limits: Limits, T_from: pin.SE3, T_to: pin.SE3) -> Trip | None:
    """Refuse a set point too far from where the robot is."""
    distance_m = float(np.linalg.norm(T_to.translation - T_from.translation))
    if distance_m > limits.step_m:
        text = f"set point {distance_m * 1e3:.1f} mm away from the arm"
        return Trip(code="step", text=text, value=distance_m, limit=limits.step_m)
    angle_rad = float(np.linalg.norm(rotation_between(T_from.rotation, T_to.rotation)))
    if angle_rad > limits.step_rad:
        text = f"set point {np.degrees(angle_rad):.1f} degrees away from the arm"
        return Trip(code="step", text=text, value=angle_rad, limit=limits.step_rad)
    return None


def check_tether(limits: Limits, p_start_m: Array, p_now_m: Array) -> Trip | None:
    """Refuse to go further from where the arm was armed."""
    distance_m = float(np.linalg.norm(p_now_m - p_start_m))
    if distance_m <= limits.tether_m:
        return None
    text = f"{distance_m * 1e3:.0f} mm away from where it was armed"
    return Trip(code="tether", text=text, value=distance_m, limit=limits.tether_m)


def check_joints(limits: Limits, joint_rad: Vec6 | Array) -> Trip | None:
    """Refuse joint angles outside the arm's range."""
    bounds = (limits.joint_min_rad, limits.joint_max_rad)
    for number, (angle, low, high) in enumerate(zip(joint_rad, *bounds, strict=True), start=1):
        if not low <= angle <= high:
            broken = low if angle < low else high
            text = f"joint {number} = {np.degrees(angle):.1f} degrees is out of its range"
            return Trip(code="joint", text=text, value=float(angle), limit=float(broken))
    return None


def check_wrench(limits: Limits, force_N: Array, torque_Nm: Array) -> Trip | None:
    """Refuse to go on above the force or torque ceiling."""
    force = float(np.linalg.norm(force_N))
    if not force <= limits.force_N:
        text = f"force {force:.1f} N is above the ceiling"
        return Trip(code="force", text=text, value=force, limit=limits.force_N)
    torque = float(np.linalg.norm(torque_Nm))
    if not torque <= limits.torque_Nm:
        text = f"torque {torque:.2f} N m is above the ceiling"
        return Trip(code="torque", text=text, value=torque, limit=limits.torque_Nm)
    return None


def limit_speed(limits: Limits, T_from: pin.SE3, T_to: pin.SE3, dt_s: float) -> pin.SE3:
    """Return the pose on the way to `T_to` that the speed limits allow after `dt_s`."""
    step_m = T_to.translation - T_from.translation
    turn_rad = rotation_between(T_from.rotation, T_to.rotation)
    scale_m = _scale(float(np.linalg.norm(step_m)), limits.speed_m_s * dt_s)
    scale_rad = _scale(float(np.linalg.norm(turn_rad)), limits.speed_rad_s * dt_s)
    if scale_m == 1.0 and scale_rad == 1.0:
        return T_to
    R = rotation_from_vector(turn_rad * scale_rad) @ T_from.rotation
    return pin.SE3(R, T_from.translation + step_m * scale_m)


def _scale(length: float, longest: float) -> float:
    return 1.0 if length <= longest else longest / length
