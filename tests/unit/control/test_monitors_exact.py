"""The regulator's stop rules, each at its exact limit, and what a restart keeps. Pure.

The press axis is base -z in all tests: the tool points down unless a test turns it.
"""

from dataclasses import replace
from math import inf, nextafter, sqrt
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.motion.frames import plus
from control.axis_task import AxisTask, VirtualMass
from control.law import start_at
from control.monitors import (
    HalfWaves,
    MonitorSample,
    MonitorSettings,
    MonitorState,
    kept_over_restart,
    no_waves,
)
from forcemesh.messages import Trip, Vec3
from tests.fakes.law_input import mode_input
from tests.fakes.monitor_steps import DOWN, monitor_sample, watched

SETTINGS = MonitorSettings(
    touch_N=2.0,
    search_m=0.03125,
    lost_m=0.0078125,
    environment_work_J=0.0625,
    half_wave=(3.0,) * 6,
    half_wave_shortest_s=0.016,
    half_wave_longest_s=0.25,
)


def next_above(number: float) -> float:
    """Return the next larger number."""
    return nextafter(number, inf)


def numbers(trip: Trip | None) -> tuple[str, float | None, float | None] | None:
    """Return code, value and limit of a trip."""
    return None if trip is None else (trip.code, trip.value, trip.limit)


@pytest.mark.parametrize("complies", [False, True])
@pytest.mark.parametrize(
    ("press_N", "aside"),
    [((0.0, 0.0, 8.0), False), ((1.0, 0.0, 8.0), False), ((1.2, 0.0, 8.0), True),
     ((4.0, 0.0, 7.0), True), ((8.0, 0.0, 0.0), True)],
)  # fmt: skip
def test_a_first_touch_aside_is_a_fault_of_a_tool_that_only_presses(
    complies: bool, press_N: Vec3, aside: bool
) -> None:
    """A task that presses elsewhere, by 8 degrees or more, or complies may be touched sideways."""
    T = pin.SE3(DOWN, np.zeros(3))
    sample = mode_input(setpoint_N=8.0, motion=start_at(T))
    shifts = (VirtualMass() if complies else None, None, None)
    task = AxisTask((True,) * 3, force_N=press_N, compliant_along=shifts)
    found = MonitorSample.of(replace(sample, task=task), start_at(T))
    assert found.along_tool == (not aside)
    assert found.side_trips == (not aside and not complies)


# --- the first touch ------------------------------------------------------------------------------

PRELOAD_N = (0.0, -1.0, -4.0)  # left by the tare: it is no part of the touch
SIDE_N = sqrt(51.0)  # with 7 N along the tool that is 10 N, of which 0.7 are along the tool


@pytest.mark.parametrize(
    ("grown_N", "limit_N"),
    [
        ((2.0, 0.0, 0.0), None),
        ((next_above(2.0), 0.0, 0.0), 0.7 * next_above(2.0)),
        ((0.0, 0.0, 2.0), None),
        ((0.0, 0.0, next_above(2.0)), None),
        ((SIDE_N, 0.0, 7.0), None),
        ((SIDE_N, 0.0, 6.99), 0.7 * sqrt(51.0 + 6.99**2)),
        ((SIDE_N, 0.0, 7.01), None),
        ((0.0, 0.0, -3.0), 2.1),
    ],
)
def test_a_first_touch_beyond_touch_n_is_along_the_tool_or_trips(grown_N, limit_N) -> None:
    """2 N at most is no touch; of a touch at least 0.7 is along the tool."""
    now, _ = watched(MonitorState(), monitor_sample("approach", PRELOAD_N), SETTINGS)
    _, trip = watched(now, monitor_sample("approach", plus(PRELOAD_N, grown_N)), SETTINGS)
    expected = None if limit_N is None else ("sensor_sign", grown_N[2], pytest.approx(limit_N))
    assert numbers(trip) == expected


def test_only_a_first_touch_from_free_space_trips() -> None:
    """Not a start in contact or at rest; a press is not checked again."""
    aside = monitor_sample("approach", (30.0, 0, 0))
    free = MonitorState(first=monitor_sample("approach"))
    assert watched(free, aside, SETTINGS)[1] is not None
    assert watched(replace(free, touched=True), aside, SETTINGS)[1] is None
    for first in (monitor_sample("free"), monitor_sample("contact")):
        assert watched(MonitorState(first=first), aside, SETTINGS)[1] is None


# --- work -----------------------------------------------------------------------------------------


def counted_mJ(begin: MonitorSample, then: MonitorSample, **stored: Any) -> tuple[float, float]:
    """Return work on the tool and by the tool after one step [mJ]."""
    before = MonitorState(first=begin, worked=begin, touched=True)
    now, _ = watched(replace(before, **stored), then, SETTINGS)
    return 1e3 * now.environment_work_J, 1e3 * now.tool_work_J


@pytest.mark.parametrize(
    ("changes", "given_mJ", "got_mJ"),
    [
        ({}, 0.0, 60.0),
        ({"follows": True}, 40.0, 0.0),  # of a moving surface's work only the part across
        ({"rotates": True}, 140.0, 0.0),
        ({"rotates": True, "follows": True}, 240.0, 0.0),
    ],
)
def test_work_is_mean_force_times_travel_plus_mean_torque_times_rotation(
    changes: Any, given_mJ: float, got_mJ: float
) -> None:
    """20 and 30 N over -4 mm, 5 and 15 N over 4 mm, 1 and 3 N m over 0.1 rad: 40 - 100 + 200 mJ."""
    begin = monitor_sample(
        "contact", (5.0, 0.0, 20.0), (0.25, 0.5, 0.75), torque_Nm=(0.0, 0.0, 1.0)
    )
    turned = pin.utils.rotate("z", 0.1) @ DOWN
    then = monitor_sample("contact", (15.0, 0.0, 30.0), (0.254, 0.5, 0.746), R=turned, **changes)
    then = replace(then, torque_Nm=(0.0, 0.0, 3.0))
    assert counted_mJ(begin, then) == pytest.approx((given_mJ, got_mJ), abs=1e-9)
    more = {"environment_work_J": 0.007, "tool_work_J": 0.011}
    summed = (given_mJ + 7.0, got_mJ + 11.0)
    assert counted_mJ(begin, then, **more) == pytest.approx(summed, abs=1e-9)


def test_at_set_point_0_the_work_of_the_tool_is_stored_and_returned_first() -> None:
    """Any cause may move the tool: the environment's work does not count; no store is negative."""
    begin = monitor_sample("contact", (0.0, 0.0, 10.0))
    for up_m, got_mJ in ((-0.001, 12.0), (0.0001, 1.0), (0.0002, 0.0), (0.001, 0.0)):
        then = monitor_sample("contact", (0.0, 0.0, 10.0), (0.0, 0.0, up_m), presses=False)
        counted = counted_mJ(begin, then, environment_work_J=0.003, tool_work_J=0.002)
        assert counted == pytest.approx((3.0, got_mJ), abs=1e-9)


@pytest.mark.parametrize(
    ("travel_m", "turn_rad", "is_counted"),
    [
        (nextafter(2e-5, 0.0), 0.0, False),
        (2e-5, 0.0, True),
        (0.0, nextafter(2e-4, 0.0), False),
        (0.0, 2e-4, True),  # exact after conversion to a matrix and back
        (1.99e-5, 1.99e-4, False),
    ],
)
def test_a_step_below_the_noise_of_the_pose_accumulates(travel_m, turn_rad, is_counted) -> None:
    """Below 0.02 mm and 0.2 mrad noise would count as work; the travel adds to the next step."""
    begin = monitor_sample("contact", (0.0, 0.0, 10.0))
    before = MonitorState(first=begin, worked=begin, touched=True)
    turned = pin.utils.rotate("z", turn_rad) @ DOWN
    then = monitor_sample("contact", (0.0, 0.0, 10.0), (0.0, 0.0, -travel_m), R=turned)
    now, _ = watched(before, then, SETTINGS)
    assert (now.worked is then) is is_counted
    assert (now.worked is begin) is not is_counted
    later = monitor_sample("contact", (0.0, 0.0, 10.0), (0.0, 0.0, -0.001))
    assert watched(now, later, SETTINGS)[0].tool_work_J == pytest.approx(0.01)


@pytest.mark.parametrize("tool_work_J", [0.0, 1.0])
@pytest.mark.parametrize("first", ["free", "approach", "contact"])
@pytest.mark.parametrize("presses", [True, False])
def test_work_of_the_environment_on_a_press_from_free_space_is_limited_by_that_of_the_tool(
    tool_work_J: float, first: Any, presses: bool
) -> None:
    """1.5 times the tool's work plus the limit is allowed, not more; the fault has the excess.

    A contact may have stored work before, and at set point 0 an operator may guide the tool.
    """
    begin, limit_J = monitor_sample(first), 0.0625 + 1.5 * tool_work_J
    for work_J, is_more in ((limit_J, False), (next_above(limit_J), True)):
        now = MonitorState(first=begin, worked=begin, touched=True)
        now.environment_work_J, now.tool_work_J = work_J, tool_work_J
        _, trip = watched(now, monitor_sample("contact", presses=presses), SETTINGS)
        trips = is_more and first == "approach" and presses
        expected = ("sensor_sign", work_J - 1.5 * tool_work_J, 0.0625)
        assert numbers(trip) == (expected if trips else None)


# --- searching, oscillation -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("first", "touched", "limit_m"),
    [
        ("approach", False, 0.03125),
        ("free", False, 0.03125),
        ("approach", True, 0.0078125),
        ("contact", True, 0.0078125),
    ],
)
def test_a_search_ends_with_its_travel(first, touched, limit_m) -> None:
    """search_m for the first contact, lost_m for the next, along the tool, from its start."""
    for p_began_m in ((0.0, 0.0, 0.0), (0.5, 0.25, 0.0)):
        began = MonitorState(first=monitor_sample(first), touched=touched, p_search_m=p_began_m)
        for travel_m, trips in ((limit_m, False), (next_above(limit_m), True), (-1.0, False)):
            sample = monitor_sample("approach", (0.0, 0.0, 0.0), (9.0, 9.0, -travel_m))
            _, trip = watched(began, sample, SETTINGS)
            assert numbers(trip) == (("travel", travel_m, limit_m) if trips else None)
            lost = trip is not None and trip.text.startswith("contact was lost and not found")
            never = trip is not None and trip.text.startswith("no contact within")
            assert (lost, never) == (trips and touched, trips and not touched)


def test_an_oscillation_is_reported_by_the_norm_of_the_force_error() -> None:
    """Ten half waves of any error alone; an error of 3 and 4 N is 5 N for any torque error."""
    sample = monitor_sample("contact", error=(3.0, 0.0, -4.0, 100.0, 100.0, 100.0))
    for axis in range(6):
        for half_waves, expected in ((9, None), (10, ("oscillation", 5.0, None))):
            swing = [HalfWaves(count=half_waves * (k == axis)) for k in range(6)]
            assert numbers(watched(MonitorState(waves=swing), sample, SETTINGS)[1]) == expected


# --- a change of set point or mode ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("first", "touched", "present", "lives_on"),
    [
        ("approach", False, "approach", False),
        ("free", False, "free", False),
        ("approach", True, "contact", True),
        ("approach", True, "approach", True),
        ("contact", True, "contact", True),
        ("contact", True, "free", False),
        ("contact", True, "approach", False),
        ("free", True, "approach", False),
    ],
)
def test_a_change_of_set_point_keeps_the_budgets_of_a_press(first, touched, present, lives_on):
    """Budgets continue from the first touch; a press begun in contact and now free starts anew."""
    swing = [HalfWaves(count=9) for _ in range(6)]
    before = MonitorState(monitor_sample(first), worked=monitor_sample(present), touched=touched)
    before.began_free, before.environment_work_J, before.waves = first == "approach", 0.02, swing
    now = kept_over_restart(before)
    kept = (now.first, now.worked, now.touched, now.environment_work_J)
    same = (before.first, before.worked, True, 0.02)
    assert kept == (same if lives_on else (None, None, False, 0.0))
    assert (now.p_search_m, now.waves) == (None, no_waves())


def test_a_change_before_the_first_sample_carries_nothing() -> None:
    """After two requests within one period no motion has occurred."""
    now = kept_over_restart(MonitorState())
    assert (now.first, now.worked) == (None, None)
    assert (now.began_free, now.touched) == (False, False)


@pytest.mark.parametrize("turns", [False, True])
def test_turning_does_work_only_where_the_mode_turns_the_tool(turns: bool) -> None:
    """2 N m over 10 mrad are 0.02 J; in mode position the tool turns for others."""
    now = MonitorState(touched=True)
    for R in (DOWN, pin.utils.rotate("z", 0.01) @ DOWN):
        sample = monitor_sample("contact", R=R, torque_Nm=(0.0, 0.0, 2.0), rotates=turns)
        now, _ = watched(now, sample, SETTINGS)
    assert now.environment_work_J == pytest.approx(0.02 if turns else 0.0)
