"""Between the tuples that messages carry and the arrays and poses that mathematics wants."""

import numpy as np
import pinocchio as pin

from common.frames import Array, R_from_quaternion, pose, quaternion_from_R
from common.messages import PoseRecord, RobotState, Vec3, Vec6


def vec3(array: Array) -> Vec3:
    """Return three numbers as a message carries them."""
    x, y, z = array.tolist()
    return (x, y, z)


def vec6(array: Array) -> Vec6:
    """Return six numbers as a message carries them."""
    a, b, c, d, e, f = array.tolist()
    return (a, b, c, d, e, f)


def record_of(T: pin.SE3) -> PoseRecord:
    """Return a pose as a message carries it."""
    return PoseRecord(
        position_m=vec3(np.asarray(T.translation)), orientation_xyzw=quaternion_from_R(T.rotation)
    )


def pose_of(record: PoseRecord | RobotState) -> pin.SE3:
    """Return the pose that a message carries."""
    return pose(record.position_m, R_from_quaternion(record.orientation_xyzw))
