"""Frame maths: rotations, poses and Kawasaki's O, A, T. Pure: arrays in, arrays out.

`R_a_b` is the orientation of frame b in frame a, so `v_a = R_a_b @ v_b`: inner names touch.
`T_a_b` is the pose of frame b in frame a (`pin.SE3`), so `T_a_c = T_a_b * T_b_c`.
`p_a_b_in_c` is the vector from a's origin to b's origin, in the axes of c [m].
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from forcemesh.messages import Vec3

Array = npt.NDArray[np.float64]

GRAVITY_M_S2 = 9.80665

# Below this sin(A) the matrix only determines the sum (or difference) of O and T.
# Half of the finest packet step for angles, 0.002 degrees (design section 3).
POLE_TOLERANCE_RAD = math.radians(0.001)


class Oat(NamedTuple):
    """Kawasaki's orientation angles: Rz(o) Ry(a) Rz(t), intrinsic ZYZ [rad]."""

    o: float
    a: float
    t: float


def skew(v: Array) -> Array:
    """Return [v]x, so that `skew(v) @ w == cross(v, w)`. Shape (3,) to (3, 3)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_from_vector(rotation_vector: Array) -> Array:
    """Return exp([w]x) for a rotation vector w [rad]. Shape (3,) to (3, 3)."""
    return np.asarray(pin.exp3(rotation_vector))


def vector_from_rotation(R: Array) -> Array:
    """Return the rotation vector [rad] of R: the inverse of `rotation_from_vector`."""
    return np.asarray(pin.log3(R))


def rotate_about_base_axes(R_base_x: Array, rotation_in_base: Array) -> Array:
    """Rotate a frame about the base axes: R' = exp([w]x) R (specification task c).

    Args:
        R_base_x: Orientation to rotate. Shape (3, 3).
        rotation_in_base: Rotation vector in base axes [rad]. Shape (3,).
    """
    return np.asarray(pin.exp3(rotation_in_base)) @ R_base_x


def rotation_between(R_base_from: Array, R_base_to: Array) -> Array:
    """Return the rotation vector in base axes [rad] from one orientation to another."""
    return np.asarray(pin.log3(R_base_to.dot(R_base_from.T)))  # `dot` is twice as fast as `@`


def apart(T_from: pin.SE3, T_to: pin.SE3) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between two poses.

    The angle is 2 atan2(|(x, y, z)|, |w|) of the unit quaternion from one to the other: it has all
    its digits near zero and near half a turn, too.
    """
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(T_from.actInv(T_to)).tolist()
    return math.hypot(x, y, z), 2.0 * math.atan2(math.hypot(qx, qy, qz), abs(qw))


def interpolated(T_from: pin.SE3, T_to: pin.SE3, share: float) -> pin.SE3:
    """Return a pose on a straight line with uniform rotation about one axis; share is 0 to 1."""
    rotation = rotation_between(T_from.rotation, T_to.rotation)
    R = rotate_about_base_axes(T_from.rotation, share * rotation)
    return pin.SE3(R, T_from.translation + share * (T_to.translation - T_from.translation))


def quaternion_from_R(R: Array) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a rotation matrix."""
    x, y, z, w = pin.Quaternion(R).coeffs().tolist()
    sign = -1.0 if w < 0.0 else 1.0
    return (sign * x, sign * y, sign * z, sign * w)


def R_from_quaternion(xyzw: tuple[float, float, float, float] | Array) -> Array:
    """Return the rotation matrix of a quaternion (x, y, z, w), normalised by `unit_quaternion`."""
    x, y, z, w = unit_quaternion(*map(float, xyzw))
    return np.asarray(pin.Quaternion(w, x, y, z).toRotationMatrix())


def unit_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float, float]:
    """Return a quaternion x, y, z, w normalised to length one.

    A zero quaternion gives NaN, which every limit refuses, not the identity.
    """
    # Divided first: squares overflow long before the numbers do.
    largest = max(abs(x), abs(y), abs(z), abs(w)) or math.nan
    x, y, z, w = x / largest, y / largest, z / largest, w / largest
    size = math.sqrt((x * x + z * z) + (y * y + w * w))
    return (x / size, y / size, z / size, w / size)


def R_from_oat(oat: Oat) -> Array:
    """Return Rz(o) Ry(a) Rz(t), Kawasaki's ZYZ (AS Language Reference Manual, appendix 3)."""
    rotate = pin.utils.rotate
    return np.asarray(rotate("z", oat.o) @ rotate("y", oat.a) @ rotate("z", oat.t))


def oat_from_R(R: Array, previous: Oat | None = None) -> Oat:
    """Return the O, A, T of a rotation, A in [0, pi], O and T in (-pi, pi].

    At the poles, A = 0 defines only O + T and A = 180 degrees only O - T: O keeps its previous
    value, T takes the remainder, and A is exactly 0 or pi. Elsewhere the triple is unique in
    these ranges, so `previous` is only used at the poles: callers that send a stream pass the
    last triple, and the stream stays continuous as far as the ranges allow.

    Args:
        R: Orientation. Shape (3, 3).
        previous: Last triple of the same stream; O = 0 is assumed without one.
    """
    sin_a = math.hypot(R[0, 2], R[1, 2])
    if sin_a > POLE_TOLERANCE_RAD:
        o = math.atan2(R[1, 2], R[0, 2])
        return Oat(_wrap(o), math.atan2(sin_a, R[2, 2]), _wrap(math.atan2(R[2, 1], -R[2, 0])))
    o = previous.o if previous is not None else 0.0
    if R[2, 2] > 0.0:
        return Oat(_wrap(o), 0.0, _wrap(math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]) - o))
    difference = math.atan2(-R[1, 0] - R[0, 1], R[1, 1] - R[0, 0])  # O - T
    return Oat(_wrap(o), math.pi, _wrap(o - difference))


def pose(position_m: Array | tuple[float, ...], R: Array) -> pin.SE3:
    """Return the pose of a position [m] and an orientation (3, 3)."""
    return pin.SE3(np.asarray(R, dtype=float), np.asarray(position_m, dtype=float))


def is_finite_pose(T: pin.SE3) -> bool:
    """Return whether every number of a pose is finite."""
    return bool(T.isApprox(T))  # x - x is zero only for a finite x


def _wrap(angle_rad: float) -> float:
    """Wrap into (-pi, pi]; minus zero becomes zero."""
    folded = math.remainder(angle_rad, math.tau)
    return math.pi if folded == -math.pi else folded + 0.0


# --- plain numbers --------------------------------------------------------------------------------
# For the control period, where conversion to arrays and back takes longer than the arithmetic.

Vector = Sequence[float]  # three of them
Rows = Sequence[Vector]  # a rotation matrix, row by row


def rotated(R: Rows, v: Vector) -> Vec3:
    """Return R v."""
    (a, b, c), (d, e, f), (g, h, i) = R
    x, y, z = v
    return (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)


def plus(a: Vector, b: Vector, times: float = 1.0) -> Vec3:
    """Return a + times b."""
    x, y, z = a
    u, v, w = b
    return (x + times * u, y + times * v, z + times * w)


def dot(a: Vector, b: Vector) -> float:
    """Return a . b."""
    x, y, z = a
    u, v, w = b
    return x * u + y * v + z * w


def cross(a: Vector, b: Vector) -> Vec3:
    """Return a x b."""
    x, y, z = a
    u, v, w = b
    return (y * w - z * v, z * u - x * w, x * v - y * u)
