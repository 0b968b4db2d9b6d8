"""Between the tuples that messages carry and the arrays and poses that mathematics wants."""

import numpy as np
import pinocchio as pin

from common.frames import Array, quaternion_from_R, unit_quaternion
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
        position_m=vec3(T.translation), orientation_xyzw=quaternion_from_R(T.rotation)
    )


def pose_of(record: PoseRecord | RobotState) -> pin.SE3:
    """Return the pose that a message carries."""
    return pin.SE3(unit_quaternion(*record.orientation_xyzw), np.array(record.position_m))
