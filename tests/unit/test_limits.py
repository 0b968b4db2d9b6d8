"""Limits: exact at their boundary, blind nowhere, and an answer, never an exception."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config import load_cell
from common.frames import is_finite_pose, rotation_between, rotation_from_vector
from common.limits import (
    Limits,
    check_joints,
    check_step,
    check_tether,
    check_workspace,
    check_wrench,
    limit_speed,
)
from common.messages import Trip

CELL = load_cell(Path(__file__).resolve().parents[2] / "cells" / "demo.yaml")
LIMITS = Limits.of(CELL)
CENTRE = (LIMITS.workspace_min_m + LIMITS.workspace_max_m) / 2.0
MIDDLE = (LIMITS.joint_min_rad + LIMITS.joint_max_rad) / 2.0
NOT_FINITE = (math.nan, math.inf, -math.inf)
HUGE = (1e30, 1e154, 1e200, 1.7e308)  # squares of the larger ones overflow

directions = hnp.arrays(float, 3, elements=st.floats(-1.0, 1.0)).filter(
    lambda v: np.linalg.norm(v) > 1e-2
)
turns = hnp.arrays(float, 3, elements=st.floats(-1.7, 1.7))
spots = hnp.arrays(float, 3, elements=st.floats(-1.0, 1.0))


def around(limit: float) -> list[float]:
    """Return values dense at a limit and sparse elsewhere, all of its sign."""
    values = [limit * share for share in (1.0, 1 - 1e-6, 1 + 1e-6, 0.99, 1.01, 0.5, 2.0)]
    for way in (math.inf, -math.inf):
        values.append(math.nextafter(limit, way))
        values.append(math.nextafter(values[-1], way))
    return values


def at(p: Any, turn: Any = (0.0, 0.0, 0.0)) -> pin.SE3:
    """Return a pose."""
    return pin.SE3(rotation_from_vector(np.array(turn)), np.array(p, dtype=float))


def assert_trip(trip: Trip | None, code: str, value: float, limit: float) -> None:
    """A trip names its rule, the number that was found and the one that it broke."""
    assert trip is not None
    assert trip.code == code
    assert trip.value == pytest.approx(value)
    assert trip.limit == limit


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", ["min", "max"])
def test_the_workspace_ends_exactly_at_its_walls(axis: int, side: str) -> None:
    """Swept at each wall; the wall itself is inside."""
    wall = getattr(LIMITS, f"workspace_{side}_m")[axis]
    for value in around(wall):
        p = CENTRE.copy()
        p[axis] = value
        inside = LIMITS.workspace_min_m[axis] <= value <= LIMITS.workspace_max_m[axis]
        trip = check_workspace(LIMITS, at(p))
        if inside:
            assert trip is None
        else:
            broken = LIMITS.workspace_min_m if value < CENTRE[axis] else LIMITS.workspace_max_m
            assert_trip(trip, "workspace", value, broken[axis])
            assert trip is not None
            assert f"TCP {'xyz'[axis]} = {value * 1e3:.1f} mm" in trip.text


@pytest.mark.parametrize("joint", range(6))
def test_each_joint_ends_exactly_at_its_limits(joint: int) -> None:
    """Swept at both ends of all six; the trip counts joints from 1 as the pendant does."""
    ends = (LIMITS.joint_min_rad[joint], LIMITS.joint_max_rad[joint])
    for value in [*around(ends[0]), *around(ends[1])]:
        q = MIDDLE.copy()
        q[joint] = value
        trip = check_joints(LIMITS, q)
        if ends[0] <= value <= ends[1]:
            assert trip is None
        else:
            assert_trip(trip, "joint", value, ends[0] if value < ends[0] else ends[1])
            assert trip is not None
            assert f"joint {joint + 1} " in trip.text


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_set_point_may_be_one_step_away_and_no_more(axis: int) -> None:
    """Swept: distance from where the arm is."""
    for length in around(LIMITS.step_m):
        trip = check_step(LIMITS, at([0, 0, 0]), at(np.eye(3)[axis] * length))
        assert (trip is None) == (length <= LIMITS.step_m)
        if trip is not None:
            assert_trip(trip, "step", length, LIMITS.step_m)
            assert f"{length * 1e3:.1f} mm" in trip.text


@given(directions, st.sampled_from(around(LIMITS.step_rad)))
def test_a_set_point_may_be_one_turn_away_and_no_more(axis: np.ndarray, angle: float) -> None:
    """The same for orientation, about any axis, up to the rounding of the logarithm."""
    T_to = at([0, 0, 0], axis / np.linalg.norm(axis) * angle)
    trip = check_step(LIMITS, at([0, 0, 0]), T_to)
    if abs(angle - LIMITS.step_rad) > 1e-9:
        assert (trip is None) == (angle <= LIMITS.step_rad)
    if trip is not None:
        assert_trip(trip, "step", angle, LIMITS.step_rad)


def test_half_a_turn_is_the_longest_turn() -> None:
    """At 180 degrees, where a turn's axis flips its sign, it is still a turn of 180 degrees."""
    for axis in np.eye(3):
        trip = check_step(LIMITS, at([0, 0, 0]), at([0, 0, 0], math.pi * axis))
        assert_trip(trip, "step", math.pi, LIMITS.step_rad)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_tether_ends_exactly(axis: int) -> None:
    """Swept: distance from where the arm was armed."""
    for length in around(LIMITS.tether_m):
        trip = check_tether(LIMITS, at(np.zeros(3)), at(np.eye(3)[axis] * length))
        assert (trip is None) == (length <= LIMITS.tether_m)
        if trip is not None:
            assert_trip(trip, "tether", length, LIMITS.tether_m)
            assert f"{length * 1e3:.0f} mm" in trip.text


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_tether_ends_for_turns_as_well(axis: int, sign: float) -> None:
    """Swept in degrees, both ways: half a turn and all beyond the limit is refused."""
    for turn_deg in (*range(0, 150, 10), 149.9, 150.1, 160.0, 170.0, 175.0, 180.0):
        turned = at(np.zeros(3), sign * math.radians(turn_deg) * np.eye(3)[axis])
        trip = check_tether(LIMITS, at(np.zeros(3)), turned)
        assert (trip is None) == (turn_deg <= 150.0), turn_deg
        if trip is not None:
            assert_trip(trip, "tether", math.radians(turn_deg), LIMITS.tether_rad)
            assert f"{turn_deg:.1f} degrees" in trip.text


@given(spots, directions)
def test_distances_are_from_where_the_arm_is_or_was(p: np.ndarray, way: np.ndarray) -> None:
    """Anywhere in base: what counts is the difference."""
    near, far = 0.99 * way / np.linalg.norm(way), 1.01 * way / np.linalg.norm(way)
    step_m, tether_m = LIMITS.step_m, LIMITS.tether_m

    assert check_step(LIMITS, at(p), at(p + near * step_m)) is None
    assert_trip(check_step(LIMITS, at(p), at(p + far * step_m)), "step", 1.01 * step_m, step_m)
    assert check_tether(LIMITS, at(p), at(p + near * tether_m)) is None
    trip = check_tether(LIMITS, at(p), at(p + far * tether_m))
    assert_trip(trip, "tether", 1.01 * tether_m, tether_m)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_force_and_torque_end_at_their_ceilings(axis: int, sign: float) -> None:
    """Swept, both ways along each axis; the ceiling itself is allowed."""
    unit = sign * np.eye(3)[axis]
    for force in around(LIMITS.force_N):
        trip = check_wrench(LIMITS, unit * force, np.zeros(3))
        assert (trip is None) == (force <= LIMITS.force_N)
        if trip is not None:
            assert_trip(trip, "force", force, LIMITS.force_N)
    for torque in around(LIMITS.torque_Nm):
        trip = check_wrench(LIMITS, np.zeros(3), unit * torque)
        assert (trip is None) == (torque <= LIMITS.torque_Nm)
        if trip is not None:
            assert_trip(trip, "torque", torque, LIMITS.torque_Nm)


def test_the_ceiling_is_of_the_length_not_of_one_axis() -> None:
    """Three axes just below the ceiling are together far above it."""
    each = np.full(3, 0.9 * LIMITS.force_N)

    trip = check_wrench(LIMITS, each, np.zeros(3))
    assert_trip(trip, "force", 0.9 * math.sqrt(3.0) * LIMITS.force_N, LIMITS.force_N)


@pytest.mark.parametrize("bad", NOT_FINITE)
def test_a_number_that_is_not_finite_is_a_trip_in_every_rule(bad: float) -> None:
    """Swept through every argument and place: a trip that can be sent, never silence or a crash."""
    good = at(CENTRE)
    for place in range(3):
        p = CENTRE.copy()
        p[place] = bad
        R = np.eye(3)
        R[place, place] = math.nan
        v = np.zeros(3)
        v[place] = bad
        trips = [
            check_workspace(LIMITS, at(p)),
            check_workspace(LIMITS, pin.SE3(R, CENTRE)),
            check_step(LIMITS, good, at(p)),
            check_step(LIMITS, at(p), good),
            check_step(LIMITS, good, pin.SE3(R, CENTRE)),
            check_step(LIMITS, pin.SE3(R, CENTRE), good),
            check_tether(LIMITS, good, pin.SE3(R, p)),
            check_tether(LIMITS, pin.SE3(R, p), good),
            check_wrench(LIMITS, v, np.zeros(3)),
            check_wrench(LIMITS, np.zeros(3), v),
            check_joints(LIMITS, np.array([*v, 0.0, 0.0, 0.0])),
            check_joints(LIMITS, np.array([0.0, 0.0, 0.0, *v])),
        ]
        assert [trip.code if trip else None for trip in trips] == ["not_finite"] * len(trips)


@pytest.mark.parametrize("huge", HUGE)
def test_a_huge_number_is_a_trip_that_can_be_sent(huge: float) -> None:
    """Finite numbers whose squares are not finite: the rule they broke, not an exception."""
    v = np.array([huge, 0.0, -huge])
    codes = [
        check_workspace(LIMITS, at(v)),
        check_step(LIMITS, at(CENTRE), at(v)),
        check_tether(LIMITS, at(CENTRE), at(v)),
        check_wrench(LIMITS, v, np.zeros(3)),
        check_wrench(LIMITS, np.zeros(3), v),
        check_joints(LIMITS, np.array([*v, *v])),
    ]
    names = ["workspace", "step", "tether", "force", "torque", "joint"]
    assert [trip.code if trip else None for trip in codes] == names


@given(spots, turns, st.lists(st.tuples(spots, turns, st.floats(0.0, 0.1)), max_size=20))
def test_no_sequence_of_wishes_is_faster_than_the_limits(
    p: np.ndarray, turn: np.ndarray, wishes: list[Any]
) -> None:
    """Whatever is asked for, and however irregularly: speed and turning speed are kept."""
    T = at(p, turn)
    for p_wanted, turn_wanted, dt_s in wishes:
        T_wanted = at(p_wanted, turn_wanted)
        T_next = limit_speed(LIMITS, T, T_wanted, dt_s)
        moved = np.linalg.norm(T_next.translation - T.translation)
        turned = np.linalg.norm(rotation_between(T.rotation, T_next.rotation))
        assert moved <= LIMITS.speed_m_s * dt_s * (1.0 + 1e-9) + 1e-12
        assert turned <= LIMITS.speed_rad_s * dt_s * (1.0 + 1e-6) + 1e-6
        assert np.linalg.norm(T_next.translation - p_wanted) <= (
            np.linalg.norm(T.translation - p_wanted) + 1e-12
        )
        T = T_next


@given(spots, turns, spots, turns)
def test_with_enough_time_a_wish_is_let_through_untouched(
    p: np.ndarray, turn: np.ndarray, p_wanted: np.ndarray, turn_wanted: np.ndarray
) -> None:
    """The very object, so that the caller can tell "limited" by identity."""
    T_wanted = at(p_wanted, turn_wanted)

    assert limit_speed(LIMITS, at(p, turn), T_wanted, 100.0) is T_wanted


@given(spots, turns, spots, turns)
def test_a_standing_wish_is_reached_on_the_straight_way(
    p: np.ndarray, turn: np.ndarray, p_wanted: np.ndarray, turn_wanted: np.ndarray
) -> None:
    """Limited again and again, the pose arrives; position stays on the line in between."""
    T, T_wanted = at(p, turn), at(p_wanted, turn_wanted)
    way = p_wanted - p
    for _ in range(40):
        T = limit_speed(LIMITS, T, T_wanted, 1.0)
        gone = T.translation - p
        assert np.linalg.norm(np.cross(way, gone)) <= 1e-9
    assert T is T_wanted


def test_no_time_means_no_motion() -> None:
    """At dt = 0 (the first period) nothing is let through but where the arm is."""
    T = at(CENTRE)

    assert limit_speed(LIMITS, T, at(CENTRE + 0.1, [0.1, 0, 0]), 0.0) == T
    assert limit_speed(LIMITS, T, at(CENTRE), 0.0) == T


def test_a_turn_is_limited_beside_a_small_way_and_a_way_beside_a_small_turn() -> None:
    """One of the two within its limit is no leave for the other."""
    T, dt_s = at(CENTRE), 0.004
    for way_m, turn_rad in ((1e-5, 0.5), (0.5, 1e-5)):
        wish = at(CENTRE + way_m * np.eye(3)[0], [turn_rad, 0.0, 0.0])
        T_next = limit_speed(LIMITS, T, wish, dt_s)
        moved = np.linalg.norm(T_next.translation - CENTRE)
        turned = np.linalg.norm(rotation_between(T.rotation, T_next.rotation))
        assert moved == pytest.approx(min(way_m, LIMITS.speed_m_s * dt_s))
        assert turned == pytest.approx(min(turn_rad, LIMITS.speed_rad_s * dt_s))


@pytest.mark.parametrize("bad", NOT_FINITE)
def test_a_wish_that_is_not_finite_stays_recognisable(bad: float) -> None:
    """Limiting speed never turns NaN into a pose that looks like one."""
    for wish in (at([bad, 0.5, 0.0]), pin.SE3(np.full((3, 3), math.nan), CENTRE)):
        T = limit_speed(LIMITS, at(CENTRE), wish, 0.004)
        assert not is_finite_pose(T)
        assert check_workspace(LIMITS, T) is not None


def test_limits_are_those_of_the_cell_file_in_si_units() -> None:
    """Degrees stay in the file."""
    quarter = CELL.model_copy(update={"limits": CELL.limits.model_copy(update={"step_deg": 90.0})})

    assert Limits.of(quarter).step_rad == pytest.approx(math.pi / 2)
    assert LIMITS.joint_max_rad[1] == pytest.approx(math.radians(135.0))
