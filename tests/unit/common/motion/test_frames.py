"""Frame maths: O, A, T everywhere and at its poles, quaternions, turns about base axes."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.motion.convert import pose_of, record_of
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
    pose,
    quaternion_from_R,
    rotate_about_base_axes,
    rotated,
    rotation_between,
    rotation_from_vector,
    skew,
    vector_from_rotation,
)
from forcemesh.messages import ZERO3, PoseRecord

angles = st.floats(-math.pi, math.pi)
tilts = st.floats(0.0, math.pi)
near_poles = st.floats(1e-9, 1e-3) | st.sampled_from([0.0, POLE_TOLERANCE_RAD, 1e-7, 1e-5])
poles = st.sampled_from([0.0, math.pi])
vectors = hnp.arrays(float, 3, elements=st.floats(-10.0, 10.0))
turns = hnp.arrays(float, 3, elements=st.floats(-1.7, 1.7))  # shorter than pi: log is its inverse
quaternions = hnp.arrays(float, 4, elements=st.floats(-1.0, 1.0)).filter(
    lambda q: np.linalg.norm(q) > 1e-3
)


def product(oat: Oat) -> np.ndarray:
    """Return Rz(o) Ry(a) Rz(t) as pinocchio multiplies it."""
    rotate = pin.utils.rotate
    return np.asarray(rotate("z", oat.o) @ rotate("y", oat.a) @ rotate("z", oat.t))


def unwrap_oat(oat: Oat, previous: Oat) -> Oat:
    """Return the equivalent triple nearest to the previous one, to compare streams.

    (O, A, T), (O + pi, -A, T + pi) and any added full turns are the same rotation.
    """
    flipped = Oat(oat.o + math.pi, -oat.a, oat.t + math.pi)
    branches = [_nearest_turns(branch, previous) for branch in (oat, flipped)]
    return min(branches, key=lambda branch: math.dist(branch, previous))


def _nearest_turns(oat: Oat, previous: Oat) -> Oat:
    """Return the triple with each angle within half a turn of the previous one."""
    turned = (p + math.remainder(x - p, math.tau) for x, p in zip(oat, previous, strict=True))
    return Oat(*turned)


def angle_between(R: np.ndarray, Q: np.ndarray) -> float:
    """Return the angle between two orientations [rad], exact for small ones too."""
    return 2.0 * math.asin(min(1.0, float(np.linalg.norm(R - Q)) / math.sqrt(8.0)))


def assert_rotation(R: np.ndarray) -> None:
    """R is orthonormal and right-handed."""
    assert pytest.approx(np.eye(3), abs=1e-12) == R @ R.T
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-12)


# --- O, A, T --------------------------------------------------------------------------------------


@given(st.builds(Oat, angles, st.floats(-10.0, 10.0), angles))
def test_oat_is_the_product_of_three_turns(oat: Oat) -> None:
    """ZYZ, intrinsic: the same matrix as pinocchio's product, for any angles."""
    assert R_from_oat(oat) == pytest.approx(product(oat), abs=1e-12)


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


@given(angles, st.floats(0.01, math.pi - 0.01), angles)
def test_away_from_the_poles_the_triple_itself_comes_back(o: float, a: float, t: float) -> None:
    """There it is unique in its ranges, whatever the previous one was."""
    assume(abs(o) < math.pi - 1e-6)
    assume(abs(t) < math.pi - 1e-6)
    back = oat_from_R(R_from_oat(Oat(o, a, t)), previous=Oat(1.0, 2.0, 3.0))

    assert back == pytest.approx((o, a, t), abs=1e-9)


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


@given(angles, near_poles, angles, poles)
def test_near_a_pole_nothing_is_lost_that_a_packet_could_carry(
    o: float, off_pole: float, t: float, pole: float
) -> None:
    """Swept through 1e-9 to 1e-3 rad from both poles: error below half a packet step."""
    R = R_from_oat(Oat(o, abs(pole - off_pole), t))
    for previous in (None, Oat(2.0, pole, -1.0)):
        back = oat_from_R(R, previous)
        limit = 1e-12 if off_pole > 1.001 * POLE_TOLERANCE_RAD else 1.001 * POLE_TOLERANCE_RAD
        assert angle_between(R_from_oat(back), R) <= limit


@given(angles, poles, angles, st.floats(1e-6, 1e-3))
def test_a_path_through_a_pole_is_continuous(o: float, pole: float, t: float, step: float) -> None:
    """Straight through the pole: with unwrapping, no angle jumps by more than the path turns."""
    previous = Oat(o, pole + 20.0 * step, t)
    for k in range(20, -21, -1):
        oat = Oat(o, pole + k * step, t)
        R = R_from_oat(oat)
        now = unwrap_oat(oat_from_R(R, previous), previous)
        assert max(abs(x - y) for x, y in zip(now, previous, strict=True)) <= (
            step + 2.0 * POLE_TOLERANCE_RAD
        )
        assert angle_between(R_from_oat(now), R) <= 1.001 * POLE_TOLERANCE_RAD
        previous = now
    assert previous == pytest.approx((o, pole - 20.0 * step, t), abs=2.0 * POLE_TOLERANCE_RAD)


@given(angles, poles, angles)
def test_turning_about_the_axis_at_a_pole_moves_t_alone(o: float, pole: float, t: float) -> None:
    """Tool exactly down, turning about its own axis: O never moves, T never jumps."""
    previous = Oat(o, pole, t)
    for _ in range(50):
        R = R_from_oat(previous) @ rotation_from_vector(np.array([0.0, 0.0, 0.2]))
        now = unwrap_oat(oat_from_R(R, previous), previous)
        assert now == pytest.approx((o, pole, previous.t + 0.2), abs=1e-9)
        previous = now


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


@given(turns)
def test_both_signs_of_a_quaternion_are_one_orientation(turn: np.ndarray) -> None:
    """A reader must not care which one a writer chose."""
    q = np.array(quaternion_from_R(rotation_from_vector(turn)))

    assert R_from_quaternion(-q) == pytest.approx(R_from_quaternion(q), abs=1e-15)


def test_a_half_turn_has_a_quaternion() -> None:
    """The real part is 0, where a naive formula divides by it: each axis, both signs."""
    for axis in np.eye(3):
        for sign in (1.0, -1.0):
            R = rotation_from_vector(sign * math.pi * axis)
            assert R_from_quaternion(quaternion_from_R(R)) == pytest.approx(R, abs=1e-12)


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


@given(vectors, turns)
def test_a_pose_survives_its_record(p: np.ndarray, turn: np.ndarray) -> None:
    """A message carries the pose, to rounding."""
    T = pose(p, rotation_from_vector(turn))

    assert pose_of(record_of(T)).homogeneous == pytest.approx(T.homogeneous, abs=1e-12)


# --- turns ----------------------------------------------------------------------------------------


@given(turns, turns)
def test_turning_about_base_axes_is_turning_from_the_left(R: np.ndarray, w: np.ndarray) -> None:
    """Task c: the base's axes stay where they are, so a fixed vector turns with exp([w]x)."""
    R_base_x = rotation_from_vector(R)
    turned = rotate_about_base_axes(R_base_x, w)

    assert_rotation(turned)
    assert turned @ R_base_x.T == pytest.approx(rotation_from_vector(w), abs=1e-12)
    assert rotation_between(R_base_x, turned) == pytest.approx(w, abs=1e-6)


@given(turns, hnp.arrays(float, 3, elements=st.floats(-1.0, 1.0)), st.integers(2, 20))
def test_small_turns_about_one_base_axis_add_up(R: np.ndarray, w: np.ndarray, n: int) -> None:
    """Some turns of w/n are one turn of w; no error builds up."""
    R_base_x = rotation_from_vector(R)
    turned = R_base_x
    for _ in range(n):
        turned = rotate_about_base_axes(turned, w / n)

    assert turned == pytest.approx(rotate_about_base_axes(R_base_x, w), abs=1e-12)


def test_a_turn_about_base_z_turns_x_towards_y() -> None:
    """The right-hand rule, once in numbers; a transposed formula would turn it to -y."""
    quarter = np.array([0.0, 0.0, math.pi / 2])

    assert rotate_about_base_axes(np.eye(3), quarter)[:, 0] == pytest.approx([0.0, 1.0, 0.0])
    tool_down = R_from_oat(Oat(0.0, math.pi, 0.0))
    assert rotate_about_base_axes(tool_down, quarter)[:, 0] == pytest.approx([0.0, -1.0, 0.0])


@given(turns)
def test_a_rotation_vector_and_back(w: np.ndarray) -> None:
    """The logarithm is the inverse of exp below half a turn."""
    assert vector_from_rotation(rotation_from_vector(w)) == pytest.approx(w, abs=1e-6)


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
