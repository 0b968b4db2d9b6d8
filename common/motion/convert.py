"""Conversion between tuples of messages and arrays and poses of the maths."""

import pinocchio as pin

from common.motion.frames import Array, numbers_of, pose_at
from forcemesh.messages import PoseRecord, RobotState, Vec3


def vec3(array: Array) -> Vec3:
    """Return an array of three numbers as a message tuple."""
    x, y, z = array.tolist()
    return (x, y, z)


def record_of(T: pin.SE3) -> PoseRecord:
    """Return a pose as a message record."""
    position_m, orientation_xyzw = numbers_of(T)
    return PoseRecord(position_m=position_m, orientation_xyzw=orientation_xyzw)


def pose_of(record: PoseRecord | RobotState) -> pin.SE3:
    """Return the pose of a message record."""
    return pose_at(record.position_m, record.orientation_xyzw)
