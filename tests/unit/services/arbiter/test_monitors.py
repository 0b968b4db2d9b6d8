"""Monitors over several periods at their exact limits, and what they find on the bus."""

import dataclasses
from math import inf, nextafter
from typing import Any, Literal

import numpy as np
import pytest

from common.config.load import load_cell
from common.motion.convert import record_of
from common.motion.frames import rotation_from_vector
from common.runtime.overruns import MOST_OVERRUNS, allowed_gap_s
from forcemesh import topics
from forcemesh.codec import Header
from forcemesh.messages import RegulatorTarget
from forcemesh.requests import Empty
from services.arbiter.inputs import COMMANDING, Inputs
from services.arbiter.monitors import (
    STREAMED,
    AlignmentMonitor,
    FeedbackMonitor,
    ResidualMonitor,
    RestMonitor,
    delay_trip,
)
from tests.contract.rig import DEMO_CELL
from tests.fakes.arbiter_world import CELL, STOPPED, T_START, World, shifted
from tests.fakes.cellmates import TOPIC_OF, Cellmates, topic_of
from tests.fakes.lab import Lab

S = 1_000_000_000


def advance(world: World, after_s: float) -> None:
    """Let time pass without a step."""
    world.now_ns += round(after_s * S)


def updated(rest: RestMonitor, world: World, after_s: float) -> float:
    """Update the check with the world after some time; return the time at rest."""
    advance(world, after_s)
    return rest.update(world.inputs())


# --- rest -----------------------------------------------------------------------------------------


def test_the_time_at_rest_counts_from_the_first_pose() -> None:
    """To the nanosecond; without a pose, and after it, it begins again."""
    world, rest = World(), RestMonitor()
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
    world, rest = World(), RestMonitor()
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
    world, rest = World(), RestMonitor()
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
    faults = world.inputs().monitored.faults
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
    world, residual = World(), ResidualMonitor(FULL_N, FULL_NM)
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
    world, residual, trip = World(), ResidualMonitor(FULL_N, FULL_NM), None
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
    world, watch, trip = World(), FeedbackMonitor(CELL), None
    for snapshot in snapshots.split():
        calibration, runs = snapshot[0], snapshot[1]
        world.silent = {"wrench"} if calibration == "." else set()
        world.change("wrench", calibration=calibration)
        world.messages["target"] = STOPPED
        if runs == "+":
            world.propose(shifted())
        trip = watch.update(world.inputs())
    assert (None if trip is None else trip.code) == ("calibration" if reported else None)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"tared": True}, "a, tared, it was a"), ({"axes_checked": False}, "axes and signs")],
)
def test_force_feedback_ends_with_a_tare_and_without_checked_axes(
    changes: dict[str, bool], words: str
) -> None:
    """Both change what the force is while it moves the arm."""
    world, watch = World(), FeedbackMonitor(CELL)
    world.change("wrench", calibration="a")
    world.propose(shifted())
    assert watch.update(world.inputs()) is None
    world.change("wrench", **changes)
    trip = watch.update(world.inputs())
    assert trip is not None
    assert trip.code == "calibration"
    assert words in trip.text


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
        watch = AlignmentMonitor(0.0625)
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
    watch = AlignmentMonitor(0.0625)
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
        reported_codes = {trip.code for trip in updated.monitored.faults}
    assert ("misaligned" in reported_codes) == reported


# --- overruns (H08) -------------------------------------------------------------------------------


@pytest.mark.parametrize(("cause", "why"), [("", ""), ("others ran", ": others ran")])
@pytest.mark.parametrize("role", COMMANDING)
def test_a_loop_that_is_late_repeatedly_is_a_fault_with_its_name(
    cell: Cellmates, role: str, cause: str, why: str
) -> None:
    """Three times in a second are allowed; once more ends motion, with the numbers."""
    cell.arm()
    cell.change(f"{role}/health", overruns=MOST_OVERRUNS, longest_gap_s=0.08)
    cell.pass_s(1.0)
    assert cell.last_status().state == "ARMED"
    cell.change(f"{role}/health", overruns=MOST_OVERRUNS + 1, late_cause=cause)
    cell.step()
    (trip,) = cell.last_status().trips
    assert (trip.code, trip.value, trip.limit) == ("overrun", 4.0, 3.0)
    assert trip.text == f"{role} was late 4 times within a second, by 80 ms{why}"
    cell.change(f"{role}/health", overruns=0)
    cell.pass_s(1.1)
    assert cell.last_status().state == "FAULT"


def test_the_arbiter_detects_its_own_late_loop(cell: Cellmates) -> None:
    """It counts its own steps: no other process can distinguish it from a slow network in time."""
    cell.arm()
    late_s = 1.1 * (allowed_gap_s(CELL, "arbiter") or 0.0)
    for number in range(1, MOST_OVERRUNS + 2):
        assert cell.last_status().state == "ARMED", number
        cell.clock.sleep_s(late_s)
        cell.step()
    (trip,) = cell.last_status().trips
    assert trip.code == "overrun"
    assert trip.text.startswith("arbiter was late 4 times")


# --- two writers (H11) ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*TOPIC_OF, "hub/health", "regulator/health"])
def test_a_second_writer_is_a_fault_within_two_periods(cell: Cellmates, name: str) -> None:
    """Swept: each topic; reported in motion, and not cleared while both write."""
    cell.arm()
    cell.add_rival(name)
    cell.step(2)
    assert cell.codes()[0] == "two_writers"
    assert cell.last_status().trips[0].text == f"two processes write {topic_of(name).key}"
    assert cell.published().permission is None
    assert cell.ask(topics.CLEAR, Empty()).code == "two_writers"


# --- misaligned (H33) -----------------------------------------------------------------------------

LIMIT_S = 2.0 / 3.0 * CELL.stale_after_s(topics.ROBOT_STATE)


@pytest.mark.parametrize(("age_s", "is_fault"), [(LIMIT_S - 0.002, False), (LIMIT_S + 0.002, True)])
def test_a_wrench_of_another_time_than_the_pose_is_a_fault(
    cell: Cellmates, age_s: float, is_fault: bool
) -> None:
    """A delayed stream is fresh by its own stamp but not by its sample. Two pairs decide."""
    cell.arm()
    cell.sample_age_s = age_s
    cell.step()
    assert cell.last_status().state == "ARMED"
    cell.step()
    assert cell.last_status().state == ("FAULT" if is_fault else "ARMED")
    if is_fault:
        (trip,) = cell.last_status().trips
        assert (trip.code, trip.limit) == ("misaligned", pytest.approx(LIMIT_S))
        assert f"wrench is {1e3 * age_s:.0f} ms older" in trip.text


def test_stamps_of_different_hosts_are_not_compared(cell: Cellmates) -> None:
    """Their clocks are independent."""
    cell.move_away("wrench")
    cell.arm()
    cell.sample_age_s = 1e4
    cell.pass_s(1.0)
    assert cell.last_status().state == "ARMED"


ALLOWED_S = CELL.robot.delay_s + CELL.robot.lag_s
DEMO_TCP = DEMO_CELL.with_name("demo-tcp.yaml")


def measured(world: World, role: str = "robot", **numbers: float) -> World:
    """Let a process report measured numbers."""
    world.change(f"{role}/health", numbers=numbers)
    return world


def refusals(world: World) -> tuple[str, str]:
    """Arm for all and, where that is refused, for jog; return both codes."""
    reply = world.core.arm(world.inputs())
    return reply.code, world.core.arm(world.inputs(), "jog").code


@pytest.mark.parametrize(
    ("role", "numbers", "code"),
    [
        ("robot", {}, "ok"),
        ("robot", {"monitor_speed_fraction": 1.0}, "ok"),
        ("robot", {"monitor_speed_fraction": 0.2}, "ok"),  # 50 mm/s: the speed of a press
        ("robot", {"monitor_speed_fraction": 0.19}, "monitor_speed"),
        ("robot", {"streamed_round_trip_p50_s": 0.99 * ALLOWED_S}, "ok"),
        ("robot", {"streamed_round_trip_p50_s": 1.01 * ALLOWED_S}, "delay"),
        ("robot", {"taken_round_trip_p50_s": 1.0}, "ok"),  # of a program that idled
        ("wrench", {"tare_age_h": 7.9}, "ok"),
        ("wrench", {"tare_age_h": 8.1}, "tare"),
    ],
)
def test_the_preflight_compares_measured_values(role: str, numbers: dict, code: str) -> None:
    """The check is for force feedback only: a jog is always possible."""
    world = measured(World(), role, **numbers).make_ready()
    for_all, for_jog = refusals(world)
    assert for_all == code
    assert for_jog in {"ok", "already"}
    if code == "tare":
        assert "8.1 h old" in " ".join(world.core.status().not_ready)


@pytest.mark.parametrize("to", [0.5, 0.993, 0.0])
def test_a_monitor_speed_that_changes_while_pressing_holds(to: float) -> None:
    """Up or down: the status has both values. The pendant sets whole percent, less is noise."""
    world = measured(World(), monitor_speed_fraction=1.0).make_active("regulator")
    assert measured(world, monitor_speed_fraction=0.996).tick(50).permission is not None
    measured(world, monitor_speed_fraction=to)
    assert world.tick().permission is None
    (trip,) = world.core.status().trips
    assert (world.core.state, trip.code) == ("HOLDING", "monitor_speed")
    assert f"became {100 * to:g} %, it was 100 %" in trip.text


@pytest.mark.parametrize(("share", "continues"), [(1.4, True), (1.6, False)])
def test_a_controller_that_becomes_late_while_pressing_holds(share: float, continues: bool) -> None:
    """The limit is 1.5 times the value of the cell file."""
    world = World().make_active("regulator")
    measured(world, streamed_round_trip_p50_s=share * ALLOWED_S)
    assert (world.tick(5).permission is not None) == continues
    if not continues:
        assert world.core.status().trips[0].code == "delay"


@pytest.mark.parametrize("margin", [1.0, 1.5])
def test_a_controller_may_be_as_late_as_the_margin_allows(margin: float) -> None:
    """The limit itself is accepted; the next number is not."""
    limit_s = margin * ALLOWED_S
    assert delay_trip({STREAMED: limit_s}, CELL, margin) is None
    trip = delay_trip({STREAMED: nextafter(limit_s, inf)}, CELL, margin)
    assert trip is not None
    assert (trip.code, trip.limit) == ("delay", limit_s)


def test_the_pendant_s_speed_turned_down_while_an_emulated_arm_presses_holds() -> None:
    """Gateway and shipped program: within a second the arm holds with the reason."""
    lab = Lab(load_cell(DEMO_TCP))
    numbers = lab.cell.client.reader(topics.HEALTH["robot"])
    lab.approach()
    lab.cell.advance(2.5)
    assert lab.force_N > 10.0
    measured_s = lab.now(numbers).numbers["streamed_round_trip_p50_s"]
    assert 0.0 < measured_s < lab.cell.cell.robot.delay_s + lab.cell.cell.robot.lag_s
    controller: Any = lab.cell.runners["sensor"].service
    controller.machine.pendant.monitor_speed(30.0)
    lab.seconds_until(lambda: lab.status.state == "HOLDING", 2.0)
    assert [trip.code for trip in lab.status.trips] == ["monitor_speed"]
