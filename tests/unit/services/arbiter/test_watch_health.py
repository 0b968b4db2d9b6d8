"""The arbiter's checks: late loops, second writers, poses and wrenches of different times."""

import pytest

from common.runtime.overruns import MOST_OVERRUNS, allowed_gap_s
from common.runtime.service import HealthReporter, Runner
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.requests import ArmRequest, Empty
from services.arbiter.inputs import COMMANDING
from services.regulator.service import Regulator
from tests.fakes.bench import CELL
from tests.fakes.cellmates import TOPIC_OF, Cellmates, topic_of
from tests.fakes.lab import Lab

PERIOD_S = 1.0 / CELL.rates.control_hz
HEALTH_S = CELL.deadlines.health_s


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


def test_the_hub_may_be_late(cell: Cellmates) -> None:
    """It commands nothing: the age of its messages shows a delay."""
    cell.arm()
    cell.change("hub/health", overruns=99)
    cell.pass_s(1.0)
    assert cell.last_status().state == "ARMED"


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


@pytest.mark.parametrize("role", ["robot", "wrench", "regulator", "arbiter"])
def test_a_process_with_short_stalls_is_reported(role: str) -> None:
    """In a whole cell it is stopped for moments too short to make a topic stale."""
    lab = Lab()
    stumble_s = 0.9 * CELL.stale_after_s(topics.ROBOT_STATE)
    for _ in range(MOST_OVERRUNS + 1):
        runner = lab.cell.runners.pop(role)
        lab.cell.advance(stumble_s)
        lab.cell.runners[role] = runner
        lab.cell.advance(0.05)
    lab.seconds_until(lambda: lab.status.state == "FAULT", 1.0 / CELL.rates.health_hz)
    assert lab.status.trips[0].code == "overrun"
    assert lab.status.trips[0].text.startswith(role if role != "robot" else ("robot", "sensor"))


# --- health that is late or missing ---------------------------------------------------------------


@pytest.mark.parametrize("role", ["hub", *COMMANDING])
def test_missing_health_names_the_role(cell: Cellmates, role: str) -> None:
    """Its loop hangs, although another thread or process may publish its topics."""
    cell.arm()
    cell.dead.add(f"{role}/health")
    cell.pass_s(HEALTH_S + 2 * PERIOD_S)
    (trip,) = cell.last_status().trips
    assert trip.code == "stale"
    assert trip.text.startswith(f"{role}/health stale: ")


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


@pytest.mark.parametrize("name", ["robot", "regulator/health"])
def test_a_second_writer_prevents_arming(cell: Cellmates, name: str) -> None:
    """It need not write in every period: one message counts for a second."""
    cell.pass_s(1.5)
    for _ in range(5):
        cell.add_rival(name)
        cell.step()
        cell.rivals.clear()
        cell.pass_s(0.5)
        reply = cell.ask(topics.ARM, ArmRequest())
        assert reply.code == "two_writers"
        assert topic_of(name).key in reply.text


def test_a_second_regulator_in_a_whole_cell_stops_the_arm_and_is_reported() -> None:
    """It was left running in another terminal and never wrote another value."""
    lab = Lab()
    lab.approach()
    cell = lab.cell
    bus = Bus("regulator", CELL.cell, cell.transport, CELL, cell.clock)
    cell.runners["second"] = Runner(Regulator(bus, CELL), [HealthReporter(bus, CELL)], cell.clock)
    lab.seconds_until(lambda: lab.status.state == "FAULT", 3 * PERIOD_S)
    assert lab.status.trips[0].code == "two_writers"
    assert "regulator/" in lab.status.trips[0].text


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
        assert "wrench is 69 ms older" in trip.text


def test_a_pose_of_another_time_than_the_wrench_is_a_fault_too(cell: Cellmates) -> None:
    """The robot's stream is late: its stamps are old, the sensor's samples are new."""
    cell.arm()
    cell.sample_age_s = -(LIMIT_S + 0.002)
    cell.step(2)
    assert "robot/state is 69 ms older" in cell.last_status().trips[0].text


def test_one_misaligned_pair_is_no_fault(cell: Cellmates) -> None:
    """Every other message is late, for seconds: no two pairs in a row are."""
    cell.arm()
    for _ in range(200):
        cell.sample_age_s = LIMIT_S + 0.005
        cell.step()
        cell.sample_age_s = 0.002
        cell.step()
    assert cell.last_status().state == "ARMED"


def test_a_writer_that_pauses_is_stale_and_never_misaligned(cell: Cellmates) -> None:
    """Ages differ more and more while one is silent: silence is reported, not misalignment."""
    cell.arm()
    cell.dead.add("wrench")
    cell.pass_s(CELL.stale_after_s(topics.WRENCH) + 2 * PERIOD_S)
    assert cell.codes() == ["stale"]


def test_stamps_of_different_hosts_are_not_compared(cell: Cellmates) -> None:
    """Their clocks are independent."""
    cell.move_away("wrench")
    cell.arm()
    cell.sample_age_s = 1e4
    cell.pass_s(1.0)
    assert cell.last_status().state == "ARMED"


def test_a_whole_cell_is_aligned_and_in_time() -> None:
    """Pressing for seconds causes no late, misaligned or doubtful input."""
    lab = Lab()
    lab.press()
    lab.cell.advance(2.0)
    assert lab.status.state == "ACTIVE"
    assert lab.status.not_ready == ()
