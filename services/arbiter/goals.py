"""Limit checks of a requested move before it begins. Pure."""

import numpy as np

from common.motion.convert import pose_of
from common.motion.limits import Limits, check_joint_count, check_joints
from forcemesh.faults import tripped
from forcemesh.messages import RobotState, Speed, Trip
from forcemesh.requests import MoveRequest
from services.arbiter.bounds import ArmBounds


def goal_trip(request: MoveRequest, robot: RobotState, bounds: ArmBounds) -> Trip | None:
    """Return the limit that the end of a move would violate, or None.

    Args:
        request: The move.
        robot: State of the robot.
        bounds: Limits of the arm.
    """
    if request.kind == "pose":
        if request.pose is None:
            return tripped("malformed", "a move to a pose needs a pose")
        return bounds.place(pose_of(request.pose))
    if request.joint_rad is None:
        return tripped("malformed", f"a move of kind {request.kind} needs joint_rad")
    if (trip := check_joint_count(bounds.limits, request.joint_rad)) is not None:
        return trip
    joint_rad = np.array(request.joint_rad)
    if request.kind == "by":
        joint_rad = joint_rad + np.array(robot.joint_rad)
    return check_joints(bounds.limits, joint_rad)


def speed_of(request: MoveRequest, usual: Speed) -> Speed:
    """Return the speeds of a move: its own if the request has one."""
    if request.speed_m_s is None:
        return usual
    requested = {"mechanical_m_s": request.speed_m_s, "modular_fraction": 1.0}
    return usual.replaced(**requested)


def real_speed_m_s(speed: Speed) -> float:
    """Return the speed of a move: mechanical times modular (specification 1.4 e)."""
    return speed.mechanical_m_s * speed.modular_fraction


def speed_trip(speed: Speed, limits: Limits) -> Trip | None:
    """Return why a speed is above the limit, or None."""
    real_m_s = real_speed_m_s(speed)
    if real_m_s <= limits.speed_m_s:
        return None
    text = "mechanical times modular speed is above limits.speed_m_s"
    return tripped("speed", text, value=real_m_s, limit=limits.speed_m_s, unit="m/s")
