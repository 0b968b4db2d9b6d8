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

from forcemesh.messages import ZERO3, Quaternion, Vec3

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
    return np.asarray(pin.exp3(rotation_in_base).dot(R_base_x))  # `dot` is twice as fast as `@`


def rotation_between(R_base_from: Array, R_base_to: Array) -> Array:
    """Return the rotation vector in base axes [rad] from one orientation to another."""
    return np.asarray(pin.log3(R_base_to.dot(R_base_from.T)))


def apart(T_from: pin.SE3, T_to: pin.SE3) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between two poses.

    The angle is 2 atan2(|(x, y, z)|, |w|) of the unit quaternion from one to the other: it has all
    its digits near zero and near half a turn, too.
    """
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUATtuple(T_from.actInv(T_to))
    return math.hypot(x, y, z), 2.0 * math.atan2(math.hypot(qx, qy, qz), abs(qw))


def interpolated(T_from: pin.SE3, T_to: pin.SE3, share: float) -> pin.SE3:
    """Return a pose on a straight line with uniform rotation about one axis; share is 0 to 1."""
    return moved(T_from, speeds_between(T_from, T_to, 1.0), share)


def quaternion_from_R(R: Array) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a rotation matrix."""
    return numbers_of(pin.SE3(R, np.zeros(3)))[1]


def R_from_quaternion(xyzw: tuple[float, float, float, float] | Array) -> Array:
    """Return the rotation matrix of a quaternion (x, y, z, w), normalised by `unit_quaternion`."""
    x, y, z, w = map(float, xyzw)
    return np.asarray(pose_at(ZERO3, (x, y, z, w)).rotation)


def unit_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float, float]:
    """Return a quaternion x, y, z, w normalised to length one.

    A zero quaternion gives NaN, which every limit refuses, not the identity.
    """
    x, y, z, w = 0.5 * x, 0.5 * y, 0.5 * z, 0.5 * w  # of any finite numbers the length is finite
    size = math.hypot(x, y, z, w) or math.nan
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


def true_sensor(T_flange_sensor: pin.SE3, mounting_rad: Vec3) -> pin.SE3:
    """Return the pose of the sensor with the identified correction of its mounting.

    Args:
        T_flange_sensor: Pose in the cell file.
        mounting_rad: `mounting_rotation_rad` of the payload, a rotation vector in its axes.
    """
    return T_flange_sensor * pose(ZERO3, rotation_from_vector(np.array(mounting_rad)))


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
Speeds = tuple[Vec3, Vec3]  # speed [m/s] and angular speed [rad/s], in base axes


def rotated(R: Rows, v: Vector) -> Vec3:
    """Return R v."""
    (a, b, c), (d, e, f), (g, h, i) = R
    x, y, z = v
    return (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)


def rotated_back(R: Rows, v: Vector) -> Vec3:
    """Return the inverse rotation of v."""
    (a, b, c), (d, e, f), (g, h, i) = R
    x, y, z = v
    return (a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z)


def product(a: Vector, b: Vector) -> Vec3:
    """Return the products along each axis."""
    x, y, z = a
    u, v, w = b
    return (x * u, y * v, z * w)


def scaled(v: Vector, factor: float) -> Vec3:
    """Return factor v."""
    x, y, z = v
    return (factor * x, factor * y, factor * z)


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


def numbers_of(T: pin.SE3) -> tuple[Vec3, Quaternion]:
    """Return position and unit quaternion x, y, z, w of a pose, w >= 0."""
    px, py, pz, x, y, z, w = pin.SE3ToXYZQUATtuple(T)
    return (px, py, pz), (-x, -y, -z, -w) if w < 0.0 else (x, y, z, w)


def pose_at(position_m: Vec3, xyzw: Quaternion) -> pin.SE3:
    """Return the pose of a position [m] and a quaternion, normalised by `unit_quaternion`.

    Without that, a rotation of 90 to 120 degrees multiplies the rounding error at every conversion.
    """
    return pin.XYZQUATToSE3(position_m + unit_quaternion(*xyzw))


def composed(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the quaternion of the rotation a b: b first."""
    x, y, z, w = a
    i, j, k, s = b
    return (
        w * i + x * s + y * k - z * j,
        w * j + y * s + z * i - x * k,
        w * k + z * s + x * j - y * i,
        w * s - x * i - y * j - z * k,
    )


def speeds_between(T_from: pin.SE3, T_to: pin.SE3, time_s: float) -> Speeds:
    """Return the constant speeds that lead from one pose to another in a time."""
    (p_from, (x, y, z, w)), (p_to, q_to) = numbers_of(T_from), numbers_of(T_to)
    i, j, k, s = composed(q_to, (-x, -y, -z, w))  # the turn, about base axes
    size = math.hypot(i, j, k)
    rate = 2.0 * math.atan2(math.copysign(size, s), abs(s)) / (size or 1.0) / time_s
    u, v, w = plus(p_to, p_from, -1.0)
    return (u / time_s, v / time_s, w / time_s), (rate * i, rate * j, rate * k)


def moved(T: pin.SE3, speeds: Speeds, time_s: float) -> pin.SE3:
    """Return a pose after a time at constant speeds: translation, then rotation."""
    (p, q), (speed, (x, y, z)) = numbers_of(T), speeds
    rate = math.hypot(x, y, z)
    half = 0.5 * time_s * rate
    share = math.sin(half) / (rate or 1.0)
    turn = (share * x, share * y, share * z, math.cos(half))
    return pose_at(plus(p, speed, time_s), composed(turn, q))
