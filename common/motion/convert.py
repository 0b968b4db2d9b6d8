"""Conversion between tuples of messages and arrays and poses of the maths."""

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, unit_quaternion
from forcemesh.messages import PoseRecord, RobotState, Vec3


def vec3(array: Array) -> Vec3:
    """Return an array of three numbers as a message tuple."""
    x, y, z = array.tolist()
    return (x, y, z)


def record_of(T: pin.SE3) -> PoseRecord:
    """Return a pose as a message record."""
    px, py, pz, x, y, z, w = pin.SE3ToXYZQUAT(T).tolist()
    quaternion = (-x, -y, -z, -w) if w < 0.0 else (x, y, z, w)
    return PoseRecord(position_m=(px, py, pz), orientation_xyzw=quaternion)


def pose_of(record: PoseRecord | RobotState) -> pin.SE3:
    """Return the pose of a message record."""
    quaternion = unit_quaternion(*record.orientation_xyzw)
    return pin.XYZQUATToSE3(np.array(record.position_m + quaternion))
