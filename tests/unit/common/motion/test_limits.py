"""Limits: exact at their boundary, blind nowhere, and an answer, never an exception."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio as pin
import pytest

from common.config.load import cell_from_tree, dump_cell, load_cell
from common.motion.frames import apart
from common.motion.limits import (
    ArmBounds,
    Limits,
    Plane,
    check_apart,
    check_joints,
    check_workspace,
    check_wrench,
    slowed,
)
from forcemesh.errors import ConfigError
from forcemesh.messages import Trip
from tests.fakes.arbiter_world import pose_at

check_step, check_tether = partial(check_apart, "step"), partial(check_apart, "tether")

DEMO_CELL = Path(__file__).resolve().parents[4] / "cells" / "demo.yaml"
CELL = load_cell(DEMO_CELL)
LIMITS = Limits.of(CELL)
CENTRE = (LIMITS.workspace_min_m + LIMITS.workspace_max_m) / 2.0
MIDDLE = (LIMITS.joint_min_rad + LIMITS.joint_max_rad) / 2.0
NOT_FINITE = (math.nan, math.inf, -math.inf)


def around(limit: float) -> list[float]:
    """Return values dense at a limit and sparse elsewhere, all of its sign."""
    values = [limit * share for share in (1.0, 1 - 1e-6, 1 + 1e-6, 0.99, 1.01, 0.5, 2.0)]
    for travel in (math.inf, -math.inf):
        values.append(math.nextafter(limit, travel))
        values.append(math.nextafter(values[-1], travel))
    return values


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
        trip = check_workspace(LIMITS, pose_at(p))
        if inside:
            assert trip is None
        else:
            broken = LIMITS.workspace_min_m if value < CENTRE[axis] else LIMITS.workspace_max_m
            assert_trip(trip, "workspace", value, broken[axis])
            assert trip is not None
            assert f"TCP {'xyz'[axis]} = {value * 1e3:.1f} mm" in trip.text


@pytest.mark.parametrize("slack_rad", [0.0, 0.01])
@pytest.mark.parametrize("joint", range(6))
def test_each_joint_ends_exactly_at_its_limits(joint: int, slack_rad: float) -> None:
    """Swept at both ends of all six, widened by a tolerance; joints count from 1."""
    low = LIMITS.joint_min_rad[joint] - slack_rad
    high = LIMITS.joint_max_rad[joint] + slack_rad
    for value in [*around(low), *around(high)]:
        q = MIDDLE.copy()
        q[joint] = value
        trip = check_joints(LIMITS, q, slack_rad=slack_rad)
        if low <= value <= high:
            assert trip is None
        else:
            assert_trip(trip, "joint", value, low if value < low else high)
            assert trip is not None
            assert f"joint {joint + 1} " in trip.text


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    ("code", "limit_m"), [("step", LIMITS.step_m), ("tether", LIMITS.tether_m)]
)
def test_the_distance_between_two_poses_ends_exactly(
    code: Literal["step", "tether"], limit_m: float, axis: int
) -> None:
    """Of a set point from the arm, and of the arm from its arming."""
    for length in around(limit_m):
        trip = check_apart(code, LIMITS, pose_at([0, 0, 0]), pose_at(np.eye(3)[axis] * length))
        assert (trip is None) == (length <= limit_m)
        if trip is not None:
            assert_trip(trip, code, length, limit_m)
            assert f"{length * 1e3:.0f}" in trip.text


def test_half_a_turn_is_the_longest_turn() -> None:
    """At 180 degrees, where a turn's axis flips its sign, it is still a turn of 180 degrees."""
    for axis in np.eye(3):
        trip = check_step(LIMITS, pose_at([0, 0, 0]), pose_at([0, 0, 0], math.pi * axis))
        assert_trip(trip, "step", math.pi, LIMITS.step_rad)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_force_and_torque_end_at_their_ceilings(axis: int, sign: float) -> None:
    """Swept, both signs of each axis; the ceiling itself is allowed."""
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
    good = pose_at(CENTRE)
    for place in range(3):
        p = CENTRE.copy()
        p[place] = bad
        R = np.eye(3)
        R[place, place] = math.nan
        v = np.zeros(3)
        v[place] = bad
        trips = [
            check_workspace(LIMITS, pose_at(p)),
            check_workspace(LIMITS, pin.SE3(R, CENTRE)),
            check_step(LIMITS, good, pose_at(p)),
            check_step(LIMITS, pose_at(p), good),
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


@pytest.mark.parametrize("check", [check_step, check_tether])
def test_a_turn_of_exactly_the_limit_is_allowed(check: Any) -> None:
    """To the last digit of the angle that is computed."""
    T_from, T_to = pose_at(CENTRE), pose_at(CENTRE, [0.1, -0.05, 0.07])
    _, angle = apart(T_from, T_to)
    for limit, rule in ((angle, None), (math.nextafter(angle, 0.0), check.args[0])):
        trip = check(replace(LIMITS, step_rad=limit, tether_rad=limit), T_from, T_to)
        assert (trip and trip.code) == rule


def test_a_plane_itself_is_inside_and_the_next_number_behind_it_is_not() -> None:
    """Of two walls the one that is broken is named, by its place in the cell file."""
    walls = (Plane(np.array([0.0, 0.0, -0.1]), np.array([0.0, 0.0, 1.0])),
             Plane(np.array([0.1, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])))  # fmt: skip
    limits = replace(LIMITS, planes=walls)
    assert check_workspace(limits, pose_at([0.1, 0.5, -0.1])) is None
    for p, number in (
        ([0.1, 0.5, math.nextafter(-0.1, -1.0)], 1),
        ([math.nextafter(0.1, 1.0), 0.5, -0.1], 2),
    ):
        trip = check_workspace(limits, pose_at(p))
        assert_trip(trip, "workspace", -abs(p[number % 2 * 2] - walls[number - 1].point_m.sum()), 0)
        assert trip is not None
        assert f"behind plane {number}" in trip.text


@pytest.mark.parametrize("number", [5, 7])
def test_angles_and_limits_that_do_not_pair_are_an_error(number: int) -> None:
    """No joint and no axis goes unjudged because another number of them has come."""
    trip = check_joints(LIMITS, np.zeros(number))
    assert trip is not None
    assert (trip.code, trip.value, trip.limit) == ("joint_count", number, 6)
    for limits in (
        replace(LIMITS, workspace_min_m=np.full(number - 3, -9.0)),
        replace(LIMITS, workspace_max_m=np.full(number - 3, 9.0)),
    ):
        with pytest.raises(ValueError, match="zip"):
            check_workspace(limits, pose_at(CENTRE))


def test_limits_are_those_of_the_cell_file_in_si_units() -> None:
    """Degrees stay in the file; a joint may use its share of its own speed."""
    cell = load_cell(
        DEMO_CELL,
        {
            "limits.step_m": 0.03, "limits.step_deg": 90.0, "limits.speed_m_s": 0.2,
            "limits.speed_deg_s": 45.0, "limits.accel_m_s2": 3.0, "limits.accel_deg_s2": 360.0,
            "limits.tether_m": 0.7, "limits.tether_deg": 120.0, "limits.force_N": 58.0,
            "limits.torque_Nm": 8.0, "limits.move_rise_N": 15.0, "limits.joint_speed_share": 0.25,
            "limits.planes": [{"point_m": [0.1, 0.2, 0.3], "normal": [0.0, 3.0, 4.0]}],
        },
    )  # fmt: skip
    limits, pi = Limits.of(cell), math.pi

    assert (limits.step_m, limits.speed_m_s, limits.accel_m_s2) == (0.03, 0.2, 3.0)
    assert (limits.tether_m, limits.force_N, limits.torque_Nm) == (0.7, 58.0, 8.0)
    assert limits.move_rise_N == 15.0
    assert [limits.step_rad, limits.speed_rad_s] == pytest.approx([pi / 2, pi / 4])
    assert [limits.accel_rad_s2, limits.tether_rad] == pytest.approx([2 * pi, 2 * pi / 3])
    assert limits.workspace_min_m.tolist() == [-0.4, 0.2, -0.2]
    assert limits.workspace_max_m.tolist() == [0.4, 0.8, 0.6]
    assert np.degrees(limits.joint_min_rad) == pytest.approx([-180, -135, -157, -200, -125, -360])
    assert np.degrees(limits.joint_max_rad) == pytest.approx([180, 135, 157, 200, 125, 360])
    share_deg_s = [92.5, 77.5, 102.5, 137.5, 137.5, 250.0]
    assert np.degrees(limits.joint_speed_rad_s) == pytest.approx(share_deg_s)
    assert limits.planes[0].point_m.tolist() == [0.1, 0.2, 0.3]
    assert limits.planes[0].normal == pytest.approx([0.0, 0.6, 0.8])


def test_a_lower_speed_counts_for_turns_at_a_lever_of_100_mm() -> None:
    """Command 5 limits streams and force feedback; it never raises a limit of the cell."""
    bounds = ArmBounds(LIMITS, pin.SE3.Identity(), pose_at(CENTRE))
    slow = slowed(bounds, 0.02).limits
    assert (slow.speed_m_s, slow.speed_rad_s) == (0.02, pytest.approx(0.2))
    assert slowed(bounds, 9.0).limits.speed_rad_s == LIMITS.speed_rad_s
    assert slowed(bounds, None) is bounds


# --- ceilings -------------------------------------------------------------------------------------

CEILINGS = {
    "limits.step_m": 0.2,
    "limits.step_deg": 90.0,
    "limits.speed_m_s": 2.0,
    "limits.speed_deg_s": 360.0,
    "limits.accel_m_s2": 20.0,
    "limits.accel_deg_s2": 5000.0,
    "limits.tether_m": 5.0,
    "limits.force_N": 1000.0,
    "limits.torque_Nm": 100.0,
    "limits.joint_speed_share": 1.0,
    "force.speed_max_m_s": 0.25,
    "force.speed_max_rad_s": 2.0,
    "force.approach_m_s": 0.25,
    "force.retreat_m": 0.002,
    "force.retreat_m_s": 0.01,
}


@pytest.mark.parametrize("path", CEILINGS)
def test_no_cell_file_gets_above_the_ceilings_of_the_code(path: str) -> None:
    """Swept: the ceiling itself loads, the next number does not, and the mistake names it."""
    section, name = path.split(".")
    tree = CELL.model_dump(mode="json")
    tree["sensor"] |= {"force_range_N": 4000.0, "torque_range_Nm": 400.0}  # saturates beyond them
    tree[section][name] = CEILINGS[path]
    assert dump_cell(cell_from_tree(tree, "x.yaml"))
    tree[section][name] = math.nextafter(CEILINGS[path], math.inf)
    with pytest.raises(ConfigError, match=rf"{section}\.{name}: must be at most"):
        cell_from_tree(tree, "x.yaml")


@pytest.mark.parametrize("number", NOT_FINITE)
def test_a_wrench_must_be_finite_where_no_ceiling_applies(number: float) -> None:
    """As the limits for backing off: an infinite force is not below an infinite ceiling."""
    limits, v = replace(LIMITS, force_N=math.inf, torque_Nm=math.inf), np.array([0.0, number, 0.0])
    for trip in (check_wrench(limits, v, np.zeros(3)), check_wrench(limits, np.zeros(3), v)):
        assert trip is not None
        assert trip.code == "not_finite"
