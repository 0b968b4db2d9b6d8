"""Whether a move that somebody asks for may be tried at all. Pure."""

import numpy as np
import pinocchio as pin

from common.convert import pose_of
from common.faults import tripped
from common.frames import Array
from common.limits import Limits, check_joints, check_tether, check_workspace
from common.messages import MoveRequest, RobotState, Trip


def goal_trip(
    request: MoveRequest,
    robot: RobotState,
    *,
    limits: Limits,
    T_flange_tcp: pin.SE3,
    armed_at_m: Array,
) -> Trip | None:
    """Return the rule that a move would break at its end, or None.

    Args:
        request: The move.
        robot: Where the arm is.
        limits: The cell's limits.
        T_flange_tcp: Tool centre point in the flange.
        armed_at_m: Flange position at which the arm was armed, base axes. Shape (3,).
    """
    if request.kind == "pose":
        if request.pose is None:
            return tripped("malformed", "a move to a pose needs a pose")
        T_base_flange = pose_of(request.pose)
        return check_workspace(limits, T_base_flange * T_flange_tcp) or check_tether(
            limits, armed_at_m, np.asarray(T_base_flange.translation)
        )
    if request.joint_rad is None:
        return tripped("malformed", f"a move of kind {request.kind} needs joint_rad")
    joint_rad = np.array(request.joint_rad)
    if request.kind == "by":
        joint_rad = joint_rad + np.array(robot.joint_rad)
    return check_joints(limits, joint_rad)
