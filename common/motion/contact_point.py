"""Point of contact on the flat face of a tool, from the wrench about the TCP. Pure."""

import numpy as np

from common.motion.frames import Array

LEAST_NORMAL_N = 2.0  # below it the noise of a torque moves the point by more than a centimetre
FACE_RADIUS_M = 0.06  # a point farther from the TCP is not on the face


def contact_point_m(R_base_tcp: Array, force_N: Array, torque_Nm: Array) -> Array:
    """Return the contact point from the TCP, in base axes [m]. Shape (3,).

    A force f at a point p of the face has the torque tau = p x f about the TCP. With the tool axis
    n, n . p = 0 gives n x tau = p (n . f), hence p = n x tau / (n . f). Without a contact of the
    face it is the TCP itself.

    Args:
        R_base_tcp: Orientation of the tool in base. Shape (3, 3).
        force_N: Force of the environment on the tool, in base axes [N]. Shape (3,).
        torque_Nm: Its torque about the TCP, in base axes [N m]. Shape (3,).
    """
    axis = R_base_tcp[:, 2]
    normal_N = float(axis @ force_N)
    if normal_N > -LEAST_NORMAL_N:  # the face can be pushed only
        return np.zeros(3)
    point_m = np.cross(axis, torque_Nm) / normal_N
    return point_m if np.linalg.norm(point_m) <= FACE_RADIUS_M else np.zeros(3)
