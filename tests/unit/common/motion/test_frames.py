"""Frame maths: O, A, T everywhere and at its poles, quaternions, turns about base axes."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.motion.convert import pose_of
from common.motion.frames import (
    POLE_TOLERANCE_RAD,
    Oat,
    R_from_oat,
    R_from_quaternion,
    apart,
    cross,
    dot,
    is_finite_pose,
    moved,
    oat_from_R,
    plus,
    quaternion_from_R,
    rotate_about_base_axes,
    rotated,
    rotation_between,
    rotation_from_vector,
    skew,
)
from forcemesh.messages import ZERO3, PoseRecord

angles = st.floats(-math.pi, math.pi)
tilts = st.floats(0.0, math.pi)
poles = st.sampled_from([0.0, math.pi])
vectors = hnp.arrays(float, 3, elements=st.floats(-10.0, 10.0))
turns = hnp.arrays(float, 3, elements=st.floats(-1.7, 1.7))  # shorter than pi: log is its inverse
quaternions = hnp.arrays(float, 4, elements=st.floats(-1.0, 1.0)).filter(
    lambda q: np.linalg.norm(q) > 1e-3
)


def angle_between(R: np.ndarray, Q: np.ndarray) -> float:
    """Return the angle between two orientations [rad], exact for small ones too."""
    return 2.0 * math.asin(min(1.0, float(np.linalg.norm(R - Q)) / math.sqrt(8.0)))


def assert_rotation(R: np.ndarray) -> None:
    """R is orthonormal and right-handed."""
    assert pytest.approx(np.eye(3), abs=1e-12) == R @ R.T
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-12)


# --- O, A, T --------------------------------------------------------------------------------------


@given(angles, tilts, angles)
@example(0.0, 0.0, 0.0)
@example(math.pi, math.pi, math.pi)
@example(-math.pi, math.pi / 2, 0.0)
def test_oat_and_back_is_the_same_orientation(o: float, a: float, t: float) -> None:
    """Everywhere: the error is rounding, or below half a packet step within the poles."""
    R = R_from_oat(Oat(o, a, t))
    back = oat_from_R(R)

    tolerance = 1e-12 if math.sin(a) > POLE_TOLERANCE_RAD else 1.001 * POLE_TOLERANCE_RAD
    assert angle_between(R_from_oat(back), R) <= tolerance


@given(angles, tilts, angles)
def test_oat_stays_in_its_ranges(o: float, a: float, t: float) -> None:
    """A in [0, pi], O and T in (-pi, pi], and no minus zero that would print as -0.000."""
    back = oat_from_R(R_from_oat(Oat(o, a, t)))

    assert 0.0 <= back.a <= math.pi
    for angle in (back.o, back.t):
        assert -math.pi < angle <= math.pi
    assert all(math.copysign(1.0, x) > 0.0 for x in back if x == 0.0)


@given(angles, poles, angles, angles)
def test_exactly_at_a_pole_o_stays_and_a_is_exact(
    o: float, a: float, t: float, before: float
) -> None:
    """A = 0 and 180 come back exactly; O keeps its value, T takes the rest."""
    R = R_from_oat(Oat(o, a, t))
    back = oat_from_R(R, previous=Oat(before, a, 0.0))

    assert back.a == a
    assert math.remainder(back.o - before, math.tau) == pytest.approx(0.0, abs=1e-12)
    assert angle_between(R_from_oat(back), R) <= 1e-12


# --- quaternions ----------------------------------------------------------------------------------


@given(quaternions)
def test_quaternion_to_matrix_and_back_up_to_sign(q: np.ndarray) -> None:
    """x, y, z, w in this order; length divided out; w is not negative; pinocchio agrees."""
    unit = q / np.linalg.norm(q)
    R = R_from_quaternion(q)
    x, y, z, w = unit
    back = np.array(quaternion_from_R(R))

    assert_rotation(R)
    assert pin.Quaternion(w, x, y, z).toRotationMatrix() == pytest.approx(R, abs=1e-12)
    assert back[3] >= 0.0
    assert np.linalg.norm(back) == pytest.approx(1.0, abs=1e-12)
    assert min(np.linalg.norm(back - unit), np.linalg.norm(back + unit)) <= 1e-7


@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1e-3, 1.0, 1e160, 1e300])
def test_the_length_of_a_quaternion_is_divided_out_however_small_or_large(scale: float) -> None:
    """Squares overflow and underflow long before the numbers themselves do."""
    q = np.array([0.1, -0.7, 0.5, 0.5])

    assert R_from_quaternion(q * scale) == pytest.approx(R_from_quaternion(q), abs=1e-12)


def test_a_quaternion_without_direction_is_no_orientation() -> None:
    """All zeros must not pass for "not turned": every limit refuses a pose that is not finite."""
    nowhere = PoseRecord(position_m=(0.0, 0.5, 0.0), orientation_xyzw=(0.0, 0.0, 0.0, 0.0))

    assert np.isnan(R_from_quaternion((0.0, 0.0, 0.0, 0.0))).all()
    assert not is_finite_pose(pose_of(nowhere))


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("entry", range(12))
def test_a_pose_with_one_number_that_is_not_finite_is_not_finite(number, entry) -> None:
    """Each of its numbers, also next to a huge one, whose square overflows."""
    numbers = np.array([*np.eye(3).ravel(), 1.7e308, 0.0, -1.7e308])
    assert is_finite_pose(pin.SE3(numbers[:9].reshape(3, 3), numbers[9:]))
    numbers[entry] = number
    assert not is_finite_pose(pin.SE3(numbers[:9].reshape(3, 3), numbers[9:]))


@given(turns, vectors, vectors, st.floats(-12.0, 0.0))
def test_the_angle_between_poses_has_all_its_digits(turn, axis, p, size) -> None:
    """From a millionth of a microradian to half a turn."""
    assume(np.linalg.norm(axis) > 1e-3)
    R, axis = rotation_from_vector(turn), axis / np.linalg.norm(axis)
    for angle in (10.0**size, math.pi - 10.0**size, math.pi):
        T_to = pin.SE3(rotation_from_vector(angle * axis) @ R, p)
        distance_m, angle_rad = apart(pin.SE3(R, np.zeros(3)), T_to)
        assert distance_m == pytest.approx(float(np.linalg.norm(p)), abs=1e-14)
        assert angle_rad == pytest.approx(angle % math.tau, rel=1e-12, abs=1e-15)


# --- turns ----------------------------------------------------------------------------------------


@given(turns, turns)
def test_turning_about_base_axes_is_turning_from_the_left(R: np.ndarray, w: np.ndarray) -> None:
    """Task c: the base's axes stay where they are, so a fixed vector turns with exp([w]x)."""
    R_base_x = rotation_from_vector(R)
    turned = rotate_about_base_axes(R_base_x, w)

    assert_rotation(turned)
    assert turned @ R_base_x.T == pytest.approx(rotation_from_vector(w), abs=1e-12)
    assert rotation_between(R_base_x, turned) == pytest.approx(w, abs=1e-6)


def test_a_turn_about_base_z_turns_x_towards_y() -> None:
    """The right-hand rule, once in numbers; a transposed formula would turn it to -y."""
    quarter = np.array([0.0, 0.0, math.pi / 2])

    assert rotate_about_base_axes(np.eye(3), quarter)[:, 0] == pytest.approx([0.0, 1.0, 0.0])
    tool_down = R_from_oat(Oat(0.0, math.pi, 0.0))
    assert rotate_about_base_axes(tool_down, quarter)[:, 0] == pytest.approx([0.0, -1.0, 0.0])


@given(vectors, vectors)
def test_skew_is_the_cross_product(v: np.ndarray, w: np.ndarray) -> None:
    """[v]x w = v x w."""
    assert skew(v) @ w == pytest.approx(np.cross(v, w), abs=1e-12)


@given(turns, vectors, vectors, st.floats(-10.0, 10.0))
def test_plain_numbers_and_arrays_have_the_same_results(turn, v, w, times) -> None:
    """Rotation, sum, dot product and cross product."""
    R = rotation_from_vector(turn)
    assert rotated(R.tolist(), v.tolist()) == pytest.approx(R @ v, abs=1e-12)
    assert plus(v.tolist(), w.tolist(), times) == pytest.approx(v + times * w, abs=1e-12)
    assert dot(v.tolist(), w.tolist()) == pytest.approx(v @ w, abs=1e-12)
    assert cross(v.tolist(), w.tolist()) == pytest.approx(np.cross(v, w), abs=1e-12)


@given(st.floats(-3.1, 3.1))
def test_a_pose_that_moves_in_many_steps_stays_a_rotation(angle_rad: float) -> None:
    """Rounding errors do not grow from step to step, wherever the tool points."""
    T = pin.SE3(rotation_from_vector(angle_rad * np.array([0.6, 0.0, 0.8])), np.zeros(3))
    for _ in range(200):
        T = moved(T, (ZERO3, (0.1, -0.2, 0.1)), 0.004)
    assert T.rotation @ T.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
