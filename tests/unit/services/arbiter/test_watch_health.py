"""The arbiter's watch: late loops, second writers, poses and wrenches of different times."""

import pytest

from common.runtime.overruns import MOST_OVERRUNS, allowed_gap_s
from common.runtime.service import Runner, reporter_of
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


@pytest.fixture
def cell() -> Cellmates:
    """A cell where everybody lives."""
    return Cellmates()


# --- overruns (H08) -------------------------------------------------------------------------------


@pytest.mark.parametrize("role", COMMANDING)
def test_a_loop_that_is_late_again_and_again_is_a_fault_with_its_name(
    cell: Cellmates, role: str
) -> None:
    """Three times in a second it may be; once more ends motion, with the numbers."""
    cell.arm()
    cell.change(f"{role}/health", overruns=MOST_OVERRUNS, longest_gap_s=0.08)
    cell.pass_s(1.0)
    assert cell.told().state == "ARMED"
    cell.change(f"{role}/health", overruns=MOST_OVERRUNS + 1)
    cell.step()
    (trip,) = cell.told().trips
    assert (trip.code, trip.value, trip.limit) == ("overrun", 4.0, 3.0)
    assert trip.text == f"{role} was late 4 times within a second, by 80 ms"
    cell.change(f"{role}/health", overruns=0)
    cell.pass_s(1.1)
    assert cell.told().state == "FAULT"


def test_the_hub_may_be_late(cell: Cellmates) -> None:
    """It commands nothing: what it delays is found by its age."""
    cell.arm()
    cell.change("hub/health", overruns=99)
    cell.pass_s(1.0)
    assert cell.told().state == "ARMED"


def test_the_arbiter_finds_its_own_loop_late(cell: Cellmates) -> None:
    """By its own steps: nobody else could tell it from a slow network in time."""
    cell.arm()
    late_s = 1.1 * (allowed_gap_s(CELL, "arbiter") or 0.0)
    for number in range(1, MOST_OVERRUNS + 2):
        assert cell.told().state == "ARMED", number
        cell.clock.sleep_s(late_s)
        cell.step()
    (trip,) = cell.told().trips
    assert trip.code == "overrun"
    assert trip.text.startswith("arbiter was late 4 times")


@pytest.mark.parametrize("role", ["robot", "wrench", "regulator", "arbiter"])
def test_a_process_that_stumbles_is_named(role: str) -> None:
    """In a whole cell: stopped for moments that are too short to make anything stale."""
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
def test_health_that_stays_away_names_the_role(cell: Cellmates, role: str) -> None:
    """Its loop hangs although its topics may go on, from another thread or another process."""
    cell.arm()
    cell.dead.add(f"{role}/health")
    cell.pass_s(HEALTH_S + 2 * PERIOD_S)
    (trip,) = cell.told().trips
    assert trip.code == "stale"
    assert trip.text.startswith(f"{role}/health stale: ")


# --- two writers (H11) ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*TOPIC_OF, "hub/health", "regulator/health"])
def test_a_second_writer_is_a_fault_within_two_periods(cell: Cellmates, name: str) -> None:
    """Swept: each topic; named in motion, and nobody clears while both are there."""
    cell.arm()
    cell.add_rival(name)
    cell.step(2)
    assert cell.codes()[0] == "two_writers"
    assert cell.told().trips[0].text == f"two processes write {topic_of(name).key}"
    assert cell.said().permission is None
    assert cell.ask(topics.CLEAR, Empty()).code == "two_writers"


@pytest.mark.parametrize("name", ["robot", "regulator/health"])
def test_a_second_writer_prevents_arming(cell: Cellmates, name: str) -> None:
    """It need not be heard every period: a sign of it counts for a second."""
    cell.pass_s(1.5)
    for _ in range(5):
        cell.add_rival(name)
        cell.step()
        cell.rivals.clear()
        cell.pass_s(0.5)
        reply = cell.ask(topics.ARM, ArmRequest())
        assert reply.code == "two_writers"
        assert topic_of(name).key in reply.text


def test_a_second_regulator_in_a_whole_cell_stops_the_arm_and_is_named() -> None:
    """Somebody forgot one in another terminal; it never wrote a word of its own choice."""
    lab = Lab()
    lab.approach()
    cell = lab.cell
    bus = Bus("regulator", CELL.cell, cell.transport, CELL, cell.clock)
    cell.runners["second"] = Runner(Regulator(bus, CELL), [reporter_of(bus, CELL)], cell.clock)
    lab.seconds_until(lambda: lab.status.state == "FAULT", 3 * PERIOD_S)
    assert lab.status.trips[0].code == "two_writers"
    assert "regulator/" in lab.status.trips[0].text


# --- misaligned (H33) -----------------------------------------------------------------------------

LIMIT_S = 2.0 / 3.0 * CELL.stale_after_s(topics.ROBOT_STATE)


@pytest.mark.parametrize(("age_s", "is_fault"), [(LIMIT_S - 0.002, False), (LIMIT_S + 0.002, True)])
def test_a_wrench_of_another_time_than_the_pose_is_a_fault(
    cell: Cellmates, age_s: float, is_fault: bool
) -> None:
    """A delayed stream is fresh by its own stamp; the sample behind it tells. Two pairs decide."""
    cell.arm()
    cell.sample_age_s = age_s
    cell.step()
    assert cell.told().state == "ARMED"
    cell.step()
    assert cell.told().state == ("FAULT" if is_fault else "ARMED")
    if is_fault:
        (trip,) = cell.told().trips
        assert (trip.code, trip.limit) == ("misaligned", pytest.approx(LIMIT_S))
        assert "wrench is 69 ms older" in trip.text


def test_a_pose_of_another_time_than_the_wrench_is_a_fault_too(cell: Cellmates) -> None:
    """The robot's stream is the late one: its stamps are old, the sensor's samples are new."""
    cell.arm()
    cell.sample_age_s = -(LIMIT_S + 0.002)
    cell.step(2)
    assert "robot/state is 69 ms older" in cell.told().trips[0].text


def test_one_pair_out_of_step_is_no_fault(cell: Cellmates) -> None:
    """Every other message is late, for seconds: each has company that is not."""
    cell.arm()
    for _ in range(200):
        cell.sample_age_s = LIMIT_S + 0.005
        cell.step()
        cell.sample_age_s = 0.002
        cell.step()
    assert cell.told().state == "ARMED"


def test_a_writer_that_pauses_is_stale_and_never_misaligned(cell: Cellmates) -> None:
    """Ages grow apart while one is silent: that is told as what it is."""
    cell.arm()
    cell.dead.add("wrench")
    cell.pass_s(CELL.stale_after_s(topics.WRENCH) + 2 * PERIOD_S)
    assert cell.codes() == ["stale"]


def test_stamps_of_different_hosts_are_not_compared(cell: Cellmates) -> None:
    """Their clocks have nothing to do with each other."""
    cell.move_away("wrench")
    cell.arm()
    cell.sample_age_s = 1e4
    cell.pass_s(1.0)
    assert cell.told().state == "ARMED"


def test_a_whole_cell_is_aligned_and_in_time() -> None:
    """Pressing for seconds: neither late nor misaligned nor doubted."""
    lab = Lab()
    lab.press()
    lab.cell.advance(2.0)
    assert lab.status.state == "ACTIVE"
    assert lab.status.not_ready == ()
