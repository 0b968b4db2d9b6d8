"""Checks over several periods: each by itself, at its exact limits."""

import dataclasses
from typing import Any, Literal

import numpy as np
import pytest

from common.motion.convert import record_of
from common.motion.frames import rotation_from_vector
from forcemesh.codec import Header
from forcemesh.messages import RegulatorTarget
from services.arbiter.inputs import Inputs
from services.arbiter.watch import AlignmentWatch, FeedbackWatch, ResidualWatch, RestWatch
from tests.fakes.arbiter_world import CELL, STOPPED, T_START, World, shifted

S = 1_000_000_000


def advance(world: World, after_s: float) -> None:
    """Let time pass without a step."""
    world.now_ns += round(after_s * S)


def updated(rest: RestWatch, world: World, after_s: float) -> float:
    """Update the check with the world after some time; return the time at rest."""
    advance(world, after_s)
    return rest.update(world.inputs())


# --- rest -----------------------------------------------------------------------------------------


def test_the_time_at_rest_counts_from_the_first_pose() -> None:
    """To the nanosecond; without a pose, and after it, it begins again."""
    world, rest = World(), RestWatch()
    assert updated(rest, world, 1.0) == 0.0
    assert updated(rest, world, 0.2) == 0.2
    assert updated(rest, world, 1e-9) == 0.200000001
    world.silent.add("robot")
    assert updated(rest, world, 1.0) == 0.0
    world.silent.clear()
    assert updated(rest, world, 1.0) == 0.0
    assert updated(rest, world, 0.3) == 0.3


@pytest.mark.parametrize(("away_m", "rests"), [(2e-4, True), (2.001e-4, False)])
def test_a_fifth_of_a_millimetre_is_still_rest(away_m: float, rests: bool) -> None:
    """It counts from the first pose, so that a slow drift is found."""
    world, rest = World(), RestWatch()
    world.change("robot", position_m=(0.0, 0.0, 0.0))
    assert updated(rest, world, 0.0) == 0.0
    world.change("robot", position_m=(0.0, 0.0, away_m))
    assert updated(rest, world, 0.5) == (0.5 if rests else 0.0)
    world.change("robot", position_m=(0.0, 0.0, 2.0 * away_m))
    assert updated(rest, world, 0.5) == 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("turn_rad", "rests"), [(1.999999e-3, True), (2.000001e-3, False)])
def test_two_milliradians_are_still_rest(turn_rad: float, rests: bool, sign: float) -> None:
    """This is the position limit at a tenth of a metre; q and -q are one orientation."""
    world, rest = World(), RestWatch()
    assert updated(rest, world, 0.0) == 0.0
    turned = T_START.copy()
    turned.rotation = rotation_from_vector(np.array([turn_rad, 0.0, 0.0])) @ T_START.rotation
    x, y, z, w = record_of(turned).orientation_xyzw
    world.change("robot", orientation_xyzw=(sign * x, sign * y, sign * z, sign * w))
    assert updated(rest, world, 0.5) == (0.5 if rests else 0.0)


# --- the arbiter's own loop -----------------------------------------------------------------------


@pytest.mark.parametrize(("gap_s", "reported"), [(1.0, False), (1.0 + 1e-6, True)])
def test_an_arbiter_that_stalled_for_more_than_a_second_reports_itself(
    gap_s: float, reported: bool
) -> None:
    """All the other processes seem silent then without a fault of theirs."""
    world = World()
    world.inputs()
    advance(world, gap_s)
    faults = world.inputs().watched.faults
    assert any("itself stalled for 1.0 s" in trip.text for trip in faults) == reported


# --- residual in free space -----------------------------------------------------------------------


FULL_N, FULL_NM = 2.0, 1.0
MORE_N, MORE_NM = np.nextafter(FULL_N, 9.0), np.nextafter(FULL_NM, 9.0)


@pytest.mark.parametrize(
    ("force_N", "torque_Nm", "reported"),
    [
        (FULL_N, FULL_NM, None),
        (MORE_N, FULL_NM, (MORE_N, FULL_N)),
        (FULL_N, MORE_NM, (MORE_NM, FULL_NM)),
        (MORE_N, MORE_NM, (MORE_N, FULL_N)),
    ],
)
def test_the_residual_may_be_as_large_as_the_cell_allows(
    force_N: float, torque_Nm: float, reported: tuple[float, float] | None
) -> None:
    """The excessive one is reported with its own limit; the force, where both are."""
    world, residual = World(), ResidualWatch(FULL_N, FULL_NM)
    world.change("wrench", force_N=(0.0, force_N, 0.0), torque_Nm=(torque_Nm, 0.0, 0.0))
    residual.update(world.inputs())
    advance(world, 1.0)
    trip = residual.update(world.inputs())
    assert (None if trip is None else (trip.value, trip.limit)) == reported


Phase = Literal["free", "contact"] | None  # the regulator's report; None: it is not running


@pytest.mark.parametrize(
    ("before", "reported"),
    [
        ([("free", 0.5)], True),
        ([("contact", 5.0), ("contact", 0.5)], False),
        ([("contact", 5.0), (None, 5.0)], False),
        ([("contact", 5.0), (None, 0.5)], True),
    ],
)
def test_a_contact_ends_where_the_tool_is_free_and_no_feedback_runs(
    before: list[tuple[Phase, float]], reported: bool
) -> None:
    """A tool that bounces is still in contact; one that was never in contact cannot bounce."""
    world, residual, trip = World(), ResidualWatch(FULL_N, FULL_NM), None
    after: list[tuple[Phase, float]] = [("free", 5.0)] * 2
    for phase, force_N in before + after:
        world.messages["target"] = STOPPED
        if phase is not None:
            world.messages["target"] = RegulatorTarget(
                mode="position", pose=shifted(), contact=phase
            )
        world.change("wrench", force_N=(0.0, 0.0, force_N))
        advance(world, 0.5)
        trip = residual.update(world.inputs())
    assert (trip is not None) == reported


# --- the calibration that force feedback relies on ------------------------------------------------


@pytest.mark.parametrize(
    ("snapshots", "reported"),
    [
        ("a- b- b+", False),
        ("a+ b- b+", False),
        ("a+ .- b+", False),
        (".+ a+ a+", False),
        ("a+ .+ a+", False),
        ("a+ b+", True),
        ("a+ .+ b+", True),
        ("a+ b+ a+", False),
    ],
)
def test_the_calibration_must_stay_only_while_force_feedback_runs(
    snapshots: str, reported: bool
) -> None:
    """Each snapshot: the calibration, or none while the wrench is silent; + where feedback runs."""
    world, watch, trip = World(), FeedbackWatch(CELL), None
    for snapshot in snapshots.split():
        calibration, runs = snapshot[0], snapshot[1]
        world.silent = {"wrench"} if calibration == "." else set()
        world.change("wrench", calibration=calibration)
        world.messages["target"] = STOPPED
        if runs == "+":
            world.propose(shifted())
        trip = watch.update(world.inputs())
    assert (None if trip is None else trip.code) == ("calibration" if reported else None)


# --- pose and wrench ------------------------------------------------------------------------------


def pair(robot_seq: int, wrench_seq: int, apart_ns: int) -> Inputs:
    """Return a snapshot whose pose is later than the wrench's sample by this time."""
    one = World().inputs()
    header = Header(seq=robot_seq, epoch=1, boot="virtual", stamp_ns=S)
    behind = {"seq": wrench_seq, "sensor_stamp_ns": S - apart_ns, "sensor_seq": 1}
    robot = one.robot._replace(header=header)
    wrench = one.wrench._replace(header=header.replaced(**behind))
    return dataclasses.replace(one, robot=robot, wrench=wrench)


@pytest.mark.parametrize("first", [(1, 1), (1, 2), (2, 1)])
@pytest.mark.parametrize(("sign", "older"), [(1, "wrench"), (-1, "robot/state")])
def test_the_second_misaligned_pair_is_reported_for_any_numbers(
    first: tuple[int, int], sign: int, older: str
) -> None:
    """A sixteenth of a second is allowed, one nanosecond more is not; one message makes no pair."""
    allowed_ns = S // 16
    for beyond_ns in (0, 1):
        watch = AlignmentWatch(0.0625)
        apart_ns = sign * (allowed_ns + beyond_ns)
        robot_seq, wrench_seq = first
        assert watch.update(pair(robot_seq, wrench_seq, apart_ns)) is None
        assert watch.update(pair(robot_seq + 1, wrench_seq, apart_ns)) is None
        assert watch.update(pair(robot_seq, wrench_seq + 1, apart_ns)) is None
        trip = watch.update(pair(robot_seq + 1, wrench_seq + 1, apart_ns))
        assert (trip is not None) == bool(beyond_ns)
        if trip is not None:
            assert (trip.code, trip.limit) == ("misaligned", 0.0625)
            assert trip.value == pytest.approx(0.0625)
            assert trip.text.startswith(f"{older} is 63 ms older")


@pytest.mark.parametrize("lost", ["robot", "wrench", "sensor", "sample"])
def test_a_missing_input_has_no_age(lost: str) -> None:
    """Pose, wrench, sensor and the wrench's sample: without a stamp there is no comparison."""
    watch = AlignmentWatch(0.0625)
    for seq in (1, 2):
        watch.update(pair(seq, seq, S))
    one = pair(3, 3, S)
    header = one.wrench.header
    if lost == "sample" and header is not None:
        header = header.replaced(sensor_stamp_ns=None)
        missing: Any = {"wrench": one.wrench._replace(header=header)}
    else:
        missing = {lost: getattr(one, lost)._replace(header=None)}
    assert watch.update(one) is not None
    assert watch.update(dataclasses.replace(one, **missing)) is None


@pytest.mark.parametrize(("apart_s", "reported"), [(0.2 - 1e-6, False), (0.2 + 1e-6, True)])
def test_two_periods_of_the_slower_topic_may_lie_between_pose_and_wrench(
    apart_s: float, reported: bool
) -> None:
    """The arm reports ten times a second, and the sensor is fast."""
    rates = CELL.rates.model_copy(update={"robot_hz": 10.0})
    world = World(CELL.model_copy(update={"rates": rates}))
    reported_codes: set[str] = set()
    for seq in range(2, 5):
        advance(world, 0.1)
        one = world.inputs()
        header = Header(seq=seq, epoch=1, boot="virtual", stamp_ns=world.now_ns)
        behind = {"sensor_stamp_ns": world.now_ns - round(apart_s * S), "sensor_seq": seq}
        wrench = one.wrench._replace(header=header.replaced(**behind))
        robot = one.robot._replace(header=header)
        updated = dataclasses.replace(one, robot=robot, wrench=wrench)
        world.watch.update(updated)
        reported_codes = {trip.code for trip in updated.watched.faults}
    assert ("misaligned" in reported_codes) == reported
