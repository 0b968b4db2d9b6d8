"""Check of the reported pose against forward kinematics, with a diagnosis of frame errors.

101 is HERE of AS: the TOOL's frame in BASE. With both NULL it is the flange in the robot base:

    T_reported = T_base^-1 T_robot_flange(q) T_tool

One sample cannot distinguish all errors, so the likely ones are tried in turn, and the first that
explains the deviation is reported.
"""

from collections.abc import Iterator
from math import degrees, radians
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from cli.doctor.checks import ReportLine, finding, passed
from common.config.cell import CellConfig
from common.motion.frames import Array, apart, oat_from_R
from common.motion.kinematics import ArmKinematics
from controller.packet_table import Scales
from forcemesh.messages import Joints

SLACK = 2.0  # times the rounding: the controller's trigonometry is single precision
SMALL_M, SMALL_RAD = 1e-3, radians(0.1)  # below: geometry of this arm, not a frame error


class Tolerance(NamedTuple):
    """Position and rotation tolerance of a pose."""

    position_m: float
    rotation_rad: float


def rounding(q: Array, scales: Scales, arm: ArmKinematics) -> Tolerance:
    """Return the error from half a packet unit of each joint, position and angle, with slack.

    Args:
        q: Joint angles [rad]. Shape (6,).
        scales: Packet units.
        arm: The model.
    """
    joint_rad = radians(0.5 / scales.joint_per_deg)
    lever_m = np.linalg.norm(arm.jacobian(q)[:3], axis=0)
    position_m = float(lever_m.sum()) * joint_rad + 3**0.5 * 0.5e-3 / scales.position_per_mm
    rotation_rad = arm.joints * joint_rad + 3.0 * radians(0.5 / scales.oat_per_deg)
    return Tolerance(SLACK * position_m, SLACK * rotation_rad)


def check_pose(
    cell: CellConfig, T_reported: pin.SE3, joint_rad: Joints, arm: ArmKinematics
) -> ReportLine:
    """Check the reported pose by forward kinematics of the reported joints [rad]."""
    q = np.array(joint_rad)
    section = cell.gateway if cell.roles.robot == "gateway" else None
    T_model, limit = arm.flange_pose(q), rounding(q, section or Scales(), arm)
    difference = Tolerance(*apart(T_model, T_reported))
    found = (
        f"{1e3 * difference.position_m:.3f} mm and {degrees(difference.rotation_rad):.4f} deg from "
        f"the model, rounding gives {1e3 * limit.position_m:.3f} mm and "
        f"{degrees(limit.rotation_rad):.4f} deg"
    )
    if _is_below(difference, limit):
        return passed("pose", found)
    if _is_below(difference, Tolerance(SMALL_M, SMALL_RAD)):
        return finding("pose", "WARN", found, "pose.small")
    tolerance = Tolerance(limit.position_m + SMALL_M, limit.rotation_rad + SMALL_RAD)
    for text, remedy, T_explained in _explanations(cell, T_model, q, arm):
        if _is_below(Tolerance(*apart(T_explained, T_reported)), tolerance):
            return finding("pose", "FAIL", f"{found}: {text}", remedy)
    text, remedy = _likely_frame(T_model, T_reported, tolerance)
    return finding("pose", "FAIL", f"{found}: {text}", remedy)


def _is_below(difference: Tolerance, limit: Tolerance) -> bool:
    return (
        difference.position_m <= limit.position_m and difference.rotation_rad <= limit.rotation_rad
    )


def _explanations(
    cell: CellConfig, T_model: pin.SE3, q: Array, arm: ArmKinematics
) -> Iterator[tuple[str, str, pin.SE3]]:
    """Yield known errors with the pose that each would report."""
    T_tcp, T_sensor = cell.tool.T_flange_tcp.pose, cell.sensor.T_flange_sensor.pose
    yield "TOOL is the cell file's TCP, not NULL", "pose.TOOL", T_model * T_tcp
    yield "TOOL is the sensor's frame, not NULL", "pose.TOOL", T_model * T_sensor
    for factor in (0.1, 0.5, 2.0, 10.0, 1000.0, 0.001):
        T_scaled = pin.SE3(T_model.rotation, factor * T_model.translation)
        yield f"positions are scaled by {factor:g}", "pose.scale", T_scaled
    for joint in range(arm.joints):
        flipped = q.copy()
        flipped[joint] = -flipped[joint]
        text = f"joint {joint + 1} has the opposite sign in the model"
        yield text, "pose.model", arm.flange_pose(flipped)
    for joint in range(arm.joints):
        for offset_deg in (90, -90, 180):
            turned = q.copy()
            turned[joint] += radians(offset_deg)
            text = f"the zero of joint {joint + 1} is {offset_deg:+d} deg off the model's"
            if joint == 0:
                text += f" (or BASE is rotated by {offset_deg:+d} deg)"
            if joint == arm.joints - 1:
                text += f" (or TOOL is rotated by {offset_deg:+d} deg)"
            yield text, "pose.model", arm.flange_pose(turned)


def _likely_frame(T_model: pin.SE3, T_reported: pin.SE3, tolerance: Tolerance) -> tuple[str, str]:
    """Return which TOOL or BASE would report that pose, and the remedy for the likely one."""
    T_tool, T_base = T_model.actInv(T_reported), T_model * T_reported.inverse()
    as_tool = f"TOOL {_pendant(T_tool)}"
    as_base = f"BASE {_pendant(T_base)}"
    if _is_along_z(T_tool, tolerance):
        return f"consistent with {as_tool}, along the flange's axis", "pose.TOOL"
    if _is_along_z(T_base, tolerance):
        return f"consistent with {as_base}, a base at another height or rotated", "pose.BASE"
    return f"consistent with {as_tool}, or {as_base}, or another arm", "pose.unclear"


def _is_along_z(T: pin.SE3, tolerance: Tolerance) -> bool:
    """Return whether a frame is shifted along, and rotated about, its z axis only."""
    tilt_rad = np.hypot(T.rotation[0, 2], T.rotation[1, 2])
    is_upright = tilt_rad <= tolerance.rotation_rad and T.rotation[2, 2] > 0.0
    return bool(is_upright and np.hypot(*T.translation[:2]) <= tolerance.position_m)


def _pendant(T: pin.SE3) -> str:
    """Return a frame as the pendant shows it: X, Y, Z [mm], O, A, T [deg]."""
    numbers = [*(1e3 * T.translation), *(degrees(angle) for angle in oat_from_R(T.rotation))]
    return "(" + ", ".join(f"{round(number, 1) + 0.0:.1f}" for number in numbers) + ")"
