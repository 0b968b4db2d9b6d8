"""The arbiter's checks: late loops, second writers, poses and wrenches of different times."""

import pytest

from common.runtime.overruns import MOST_OVERRUNS, allowed_gap_s
from forcemesh import topics
from forcemesh.requests import Empty
from services.arbiter.inputs import COMMANDING
from tests.fakes.bench import CELL
from tests.fakes.cellmates import TOPIC_OF, Cellmates, topic_of

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
        assert "wrench is 69 ms older" in trip.text


def test_stamps_of_different_hosts_are_not_compared(cell: Cellmates) -> None:
    """Their clocks are independent."""
    cell.move_away("wrench")
    cell.arm()
    cell.sample_age_s = 1e4
    cell.pass_s(1.0)
    assert cell.last_status().state == "ARMED"
