"""The rules by which the regulator gives up, each at the last digit of what is allowed. Pure.

The press axis is base -z in all of it: the tool points down unless a test turns it.
"""

from dataclasses import replace
from math import inf, nextafter, sqrt
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from forcemesh.messages import Trip
from services.regulator.guards import (
    GuardSample,
    GuardSettings,
    GuardState,
    kept_over_restart,
    verifies_press_axis,
    watch,
)
from services.regulator.oscillation import HalfWaves, OscillationSettings
from services.regulator.unverified_axes import ToolMotion, YieldSettings
from tests.fakes.bench import CELL

DOWN = np.diag([1.0, -1.0, -1.0])
Z_ONLY = np.array([False, False, True])
SETTINGS = GuardSettings(
    touch_N=2.0,
    search_m=0.03125,
    lost_m=0.0078125,
    environment_work_J=0.0625,
    swing=OscillationSettings(np.full(6, 3.0), 0.016, 0.25),
    yielding=YieldSettings(0.45, 0.03),
)


def seen(
    contact: Any, force_N: Any = (0.0, 0.0, 0.0), p_m: Any = (0.0, 0.0, 0.0), **changes: Any
) -> GuardSample:
    """Return one sample."""
    T = pin.SE3(changes.pop("R", DOWN), np.array(p_m))
    fields: dict[str, Any] = {"error": np.zeros(6), "turns": False, "dt_s": 0.004}
    fields |= {"torque_Nm": np.zeros(3), "setpoint_N": 8.0} | changes
    return GuardSample(force_N=np.array(force_N), T_base_tcp=T, contact=contact, **fields)


def above(number: float) -> float:
    """Return the next number."""
    return nextafter(number, inf)


def numbers(trip: Trip | None) -> tuple[str, float | None, float | None] | None:
    """Return code, value and limit of a trip."""
    return None if trip is None else (trip.code, trip.value, trip.limit)


def test_the_settings_are_those_of_the_cell_file() -> None:
    """Each limit comes from the field of its name; the tool is idle below 1.5 deadbands."""
    settings = GuardSettings.of(CELL)
    force = CELL.force
    named = (settings.touch_N, settings.search_m, settings.lost_m, settings.environment_work_J)
    assert named == (force.touch_N, force.search_m, force.lost_m, force.environment_work_J)
    idle = (1.5 * force.deadband_N, 1.5 * force.deadband_Nm)
    assert (settings.yielding.idle_N, settings.yielding.idle_Nm) == idle


# --- the first touch ------------------------------------------------------------------------------

PRELOAD_N = np.array([0.5, -1.0, -4.0])
SIDE_N = sqrt(51.0)  # with 7 N along the tool that is 10 N, of which 0.7 are along the tool


@pytest.mark.parametrize(
    ("grown_N", "limit_N", "proves"),
    [
        ((2.0, 0.0, 0.0), None, False),
        ((above(2.0), 0.0, 0.0), 0.7 * above(2.0), False),
        ((0.0, 0.0, 2.0), None, False),
        ((0.0, 0.0, above(2.0)), None, True),
        ((SIDE_N, 0.0, 7.0), None, False),
        ((SIDE_N, 0.0, 6.99), 0.7 * sqrt(51.0 + 6.99**2), False),
        ((SIDE_N, 0.0, 7.01), None, True),
        ((0.0, 0.0, -3.0), 2.1, False),
    ],
)
def test_a_first_touch_beyond_touch_n_is_along_the_tool_or_ends_it(
    grown_N: Any, limit_N: float | None, proves: bool
) -> None:
    """No more than 2 N is no touch; of a touch 0.7 is along the tool, and more than that proves."""
    now, _ = watch(GuardState(), seen("approach"), SETTINGS)
    touch = seen("approach", grown_N)
    _, trip = watch(now, touch, SETTINGS)
    expected = None if limit_N is None else ("sensor_sign", grown_N[2], pytest.approx(limit_N))
    assert numbers(trip) == expected
    assert verifies_press_axis(now, touch, SETTINGS) is proves


def test_only_what_grows_since_the_approach_began_is_a_touch() -> None:
    """A force that the tare left is subtracted, along the tool and across it."""
    now, _ = watch(GuardState(), seen("approach", PRELOAD_N), SETTINGS)
    for grown_N, code, proves in (
        ((0.0, 0.0, 1.9), None, False),
        ((0.0, 0.0, 2.1), None, True),
        ((2.1, 0.0, 0.0), "sensor_sign", False),
        ((0.0, 0.0, -2.1), "sensor_sign", False),
    ):
        touch = seen("approach", PRELOAD_N + grown_N)
        _, trip = watch(now, touch, SETTINGS)
        assert (None if trip is None else trip.code) == code
        assert verifies_press_axis(now, touch, SETTINGS) is proves


@pytest.mark.parametrize("first", ["free", "contact"])
def test_force_feedback_that_begins_in_contact_or_stands_still_proves_nothing(first: Any) -> None:
    """Its first reading is no free space: neither a sign nor its fault can be read from it."""
    now = GuardState(first=seen(first))
    assert not verifies_press_axis(now, seen("approach", (0.0, 0.0, 30.0)), SETTINGS)
    for contact in ("free", "approach"):
        assert watch(now, seen(contact, (30.0, 0.0, 0.0)), SETTINGS)[1] is None


def test_neither_proof_nor_fault_comes_of_what_is_no_first_touch() -> None:
    """Before the first sample, at set point 0, and after the touch, when a surface may lie aslant.

    A press that loses contact is not judged again by what it feels on its way.
    """
    pressing = seen("contact", (0.0, 0.0, 30.0))
    began = GuardState(first=seen("approach"))
    assert verifies_press_axis(began, pressing, SETTINGS)
    assert not verifies_press_axis(GuardState(), pressing, SETTINGS)
    assert not verifies_press_axis(began, replace(pressing, presses=False), SETTINGS)
    for contact in ("contact", "approach"):
        aslant = seen(contact, (30.0, 0.0, 0.0))
        assert watch(replace(began, touched=True), aslant, SETTINGS)[1] is None


# --- work -----------------------------------------------------------------------------------------


def counted_mJ(begin: GuardSample, then: GuardSample, **remembered: Any) -> tuple[float, float]:
    """Return work on the tool and by the tool after one step [mJ]."""
    before = GuardState(first=begin, worked=begin, touched=True)
    now, _ = watch(replace(before, **remembered), then, SETTINGS)
    return 1e3 * now.environment_work_J, 1e3 * now.tool_work_J


@pytest.mark.parametrize(
    ("changes", "given_mJ", "got_mJ"),
    [
        ({}, 0.0, 60.0),
        ({"follows": True}, 40.0, 0.0),  # of what a moving surface does, only what is across
        ({"turns": True}, 140.0, 0.0),
        ({"turns": True, "follows": True}, 240.0, 0.0),
    ],
)
def test_work_is_the_mean_force_times_the_way_and_the_mean_torque_times_the_turn(
    changes: Any, given_mJ: float, got_mJ: float
) -> None:
    """20 and 30 N over -4 mm, 5 and 15 N over 4 mm, 1 and 3 N m over 0.1 rad: 40 - 100 + 200 mJ."""
    begin = seen("contact", (5.0, 0.0, 20.0), (0.25, 0.5, 0.75), torque_Nm=np.array([0, 0, 1.0]))
    turned = pin.utils.rotate("z", 0.1) @ DOWN
    then = seen("contact", (15.0, 0.0, 30.0), (0.254, 0.5, 0.746), R=turned, **changes)
    then = replace(then, torque_Nm=np.array([0.0, 0.0, 3.0]))
    assert counted_mJ(begin, then) == pytest.approx((given_mJ, got_mJ), abs=1e-9)
    more = {"environment_work_J": 0.007, "tool_work_J": 0.011}
    summed = (given_mJ + 7.0, got_mJ + 11.0)
    assert counted_mJ(begin, then, **more) == pytest.approx(summed, abs=1e-9)


def test_at_set_point_0_what_the_tool_does_is_stored_and_goes_back_first() -> None:
    """Anything may move the tool then: nothing is given, and no store is less than empty."""
    begin = seen("contact", (0.0, 0.0, 10.0))
    for up_m, got_mJ in ((-0.001, 12.0), (0.0001, 1.0), (0.0002, 0.0), (0.001, 0.0)):
        then = seen("contact", (0.0, 0.0, 10.0), (0.0, 0.0, up_m), presses=False)
        counted = counted_mJ(begin, then, environment_work_J=0.003, tool_work_J=0.002)
        assert counted == pytest.approx((3.0, got_mJ), abs=1e-9)


@pytest.mark.parametrize(
    ("way_m", "turn_rad", "is_counted"),
    [
        (nextafter(2e-5, 0.0), 0.0, False),
        (2e-5, 0.0, True),
        (0.0, nextafter(2e-4, 0.0), False),
        (0.0, 2e-4, True),  # so small a turn comes back from its rotation unchanged
        (1.99e-5, 1.99e-4, False),
    ],
)
def test_a_step_within_the_poses_noise_waits_until_it_has_become_one(
    way_m: float, turn_rad: float, is_counted: bool
) -> None:
    """Below 0.02 mm and 0.2 mrad noise would count as work; the way is kept, and counted whole."""
    begin = seen("contact", (0.0, 0.0, 10.0))
    before = GuardState(first=begin, worked=begin, touched=True)
    turned = pin.utils.rotate("z", turn_rad) @ DOWN
    then = seen("contact", (0.0, 0.0, 10.0), (0.0, 0.0, -way_m), R=turned)
    now, _ = watch(before, then, SETTINGS)
    assert (now.worked is then) is is_counted
    assert (now.worked is begin) is not is_counted
    later = seen("contact", (0.0, 0.0, 10.0), (0.0, 0.0, -0.001))
    assert watch(now, later, SETTINGS)[0].tool_work_J == pytest.approx(0.01)


def test_on_its_way_to_the_first_touch_the_tool_does_no_work() -> None:
    """What drags on the tool before gives it no credit: the count begins at the touch."""
    now = GuardState()
    for z_m in (0.0, -0.01, -0.02):
        now, _ = watch(now, seen("approach", (0.0, 0.0, 1.0), (0.0, 0.0, z_m)), SETTINGS)
    now, _ = watch(now, seen("contact", (0.0, 0.0, 9.0), (0.0, 0.0, -0.03)), SETTINGS)
    assert (now.environment_work_J, now.tool_work_J) == (0.0, 0.0)
    now, _ = watch(now, seen("contact", (0.0, 0.0, 11.0), (0.0, 0.0, -0.031)), SETTINGS)
    assert (now.environment_work_J, now.tool_work_J) == (0.0, pytest.approx(0.01))


@pytest.mark.parametrize("tool_work_J", [0.0, 1.0])
def test_what_is_pressed_on_does_no_more_work_than_half_more_than_the_tool_and_the_limit(
    tool_work_J: float,
) -> None:
    """Not a bit more; the fault says how much more than its half it was."""
    begin = seen("approach")
    most_J = 0.0625 + 1.5 * tool_work_J
    for environment_work_J, trips in ((most_J, False), (above(most_J), True)):
        now = GuardState(
            first=begin,
            worked=begin,
            touched=True,
            environment_work_J=environment_work_J,
            tool_work_J=tool_work_J,
        )
        _, trip = watch(now, seen("contact"), SETTINGS)
        expected = ("sensor_sign", environment_work_J - 1.5 * tool_work_J, 0.0625)
        assert numbers(trip) == (expected if trips else None)


@pytest.mark.parametrize("first", ["free", "approach", "contact"])
@pytest.mark.parametrize("presses", [True, False])
def test_only_a_press_that_began_in_free_space_is_judged_by_work(first: Any, presses: bool) -> None:
    """A contact may have stored work before, and at set point 0 a person may lead the tool."""
    begin = seen(first)
    now = GuardState(first=begin, worked=begin, touched=True, environment_work_J=1.0)
    _, trip = watch(now, seen("contact", presses=presses), SETTINGS)
    assert (trip is not None) is (first == "approach" and presses)


# --- the force that grows while the tool turns ----------------------------------------------------


@pytest.mark.parametrize(("force_N", "trips"), [(14.0, False), (above(14.0), True), (99.0, True)])
def test_an_unproven_turn_presses_half_the_set_point_and_touch_n_more(
    force_N: float, trips: bool
) -> None:
    """8 N wanted: 14 N at most, once the force has been at 8 N or below; before, it may fall."""
    turning = {"turns": True, "limited": np.array([True, False, False])}
    for first_N, was_found in ((8.0, True), (above(8.0), False)):
        now, trip = watch(GuardState(), seen("contact", (0.0, 0.0, first_N), **turning), SETTINGS)
        assert trip is None
        now, trip = watch(now, seen("contact", (0.0, 0.0, force_N), **turning), SETTINGS)
        expected = ("sensor_sign", force_N, 14.0)
        assert numbers(trip) == (expected if trips and was_found else None)


@pytest.mark.parametrize("changes", [{"turns": False}, {"presses": False}, {"limited": ~Z_ONLY}])
def test_a_force_may_grow_where_nothing_turns_or_presses_or_all_is_proved(changes: Any) -> None:
    """Each of the three alone is reason enough."""
    fields = {"turns": True, "limited": Z_ONLY} | changes
    fields["limited"] = fields["limited"] & Z_ONLY
    now, _ = watch(GuardState(), seen("contact", (0.0, 0.0, 8.0), **fields), SETTINGS)
    assert watch(now, seen("contact", (0.0, 0.0, 99.0), **fields), SETTINGS)[1] is None


# --- giving way, searching, swinging --------------------------------------------------------------


def test_along_an_unproven_axis_of_the_tool_it_gives_way_by_2_mm() -> None:
    """The tool's own axis counts, however the tool is turned; along a proved one it goes on."""
    aside = pin.utils.rotate("y", np.pi / 2)  # the tool's z is base x
    for moved_m, limited, trips in (
        ((0.0019, 0.0, 0.0), Z_ONLY, False),
        ((0.0021, 0.0, 0.0), Z_ONLY, True),
        ((0.0021, 0.0, 0.0), ~Z_ONLY, False),
    ):
        motion = ToolMotion(np.array(moved_m), np.zeros(3))
        sample = seen("free", (20.0, 0.0, 0.0), R=aside, motion=motion, limited=limited)
        _, trip = watch(GuardState(), sample, SETTINGS)
        expected = ("sensor_sign", pytest.approx(0.0021), 0.002)
        assert numbers(trip) == (expected if trips else None)


@pytest.mark.parametrize(
    ("first", "touched", "limited", "lost_m", "limit_m"),
    [
        ("approach", False, Z_ONLY, 0.0078125, 0.03125),
        ("free", False, Z_ONLY, 0.0078125, 0.03125),
        ("approach", True, Z_ONLY, 0.0078125, 0.0078125),
        ("contact", True, ~Z_ONLY, 0.0078125, 0.0078125),
        ("contact", True, Z_ONLY, 0.0078125, 0.002),
        ("contact", True, Z_ONLY, 0.001, 0.001),
    ],
)
def test_a_search_ends_with_its_way(
    first: Any, touched: bool, limited: Any, lost_m: float, limit_m: float
) -> None:
    """search_m for the first contact, lost_m for the next, 2 mm where losing it proves nothing.

    It counts along the tool, from where it began.
    """
    settings = replace(SETTINGS, lost_m=lost_m)
    for p_began_m in ((0.0, 0.0, 0.0), (0.5, 0.25, 0.0)):
        began = GuardState(first=seen(first), touched=touched, p_search_m=np.array(p_began_m))
        for way_m, trips in ((limit_m, False), (above(limit_m), True), (-1.0, False)):
            sample = seen("approach", (0.0, 0.0, 0.0), (9.0, 9.0, -way_m), limited=limited)
            _, trip = watch(began, sample, settings)
            assert numbers(trip) == (("travel", way_m, limit_m) if trips else None)
            lost = trip is not None and trip.text.startswith("contact was lost and not found")
            never = trip is not None and trip.text.startswith("no contact within")
            assert (lost, never) == (trips and touched, trips and not touched)


def test_a_search_begins_where_the_tool_is_and_ends_with_the_next_contact() -> None:
    """While it lasts its beginning stays."""
    now = GuardState()
    for contact, z_m, began_m in (
        ("free", 0.0, None),
        ("approach", -0.001, -0.001),
        ("approach", -0.002, -0.001),
        ("contact", -0.003, None),
        ("approach", -0.004, -0.004),
        ("free", -0.005, None),
    ):
        now, trip = watch(now, seen(contact, p_m=(0.0, 0.0, z_m)), SETTINGS)
        assert trip is None
        assert (now.p_search_m is None) is (began_m is None)
        assert now.p_search_m is None or now.p_search_m[2] == began_m


def test_a_force_that_swings_is_told_by_its_size_and_not_by_the_torques() -> None:
    """3 and 4 N off are 5 N, whatever the torque's error is; before the tenth half wave nothing."""
    error = np.array([3.0, 0.0, -4.0, 100.0, 100.0, 100.0])
    for count, expected in ((9.0, None), (10.0, ("oscillation", 5.0, None))):
        now = GuardState(swing=HalfWaves(count=np.array([0, 0, 0, 0, count, 0])))
        assert numbers(watch(now, seen("contact", error=error), SETTINGS)[1]) == expected


# --- what is carried over a change ----------------------------------------------------------------


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
def test_a_change_of_set_point_forgives_nothing_that_a_press_has_done(
    first: Any, touched: bool, present: Any, lives_on: bool
) -> None:
    """Budgets live on from the first touch; what never began free and is free now begins anew."""
    before = GuardState(
        first=seen(first),
        worked=seen(present),
        touched=touched,
        found=True,
        environment_work_J=0.02,
        tool_work_J=0.03,
        p_search_m=np.zeros(3),
        swing=HalfWaves(count=np.full(6, 9.0)),
    )
    now = kept_over_restart(before)
    kept = (now.first, now.worked, now.touched, now.environment_work_J, now.tool_work_J)
    same = (before.first, before.worked, True, 0.02, 0.03)
    assert kept == (same if lives_on else (None, None, False, 0.0, 0.0))
    assert (now.found, now.p_search_m) == (False, None)
    assert not now.swing.count.any()
    assert now.yielding is before.yielding


def test_a_change_before_the_first_sample_carries_nothing() -> None:
    """Asked for twice within one period: nothing was done yet."""
    now = kept_over_restart(GuardState())
    nothing = (None, None, False, False, 0.0, 0.0)
    assert (
        now.first,
        now.worked,
        now.touched,
        now.found,
        now.environment_work_J,
        now.tool_work_J,
    ) == nothing
