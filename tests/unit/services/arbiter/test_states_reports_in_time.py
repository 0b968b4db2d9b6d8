"""From a fault to its code on arbiter/status: one period, without waiting for the rate (R21)."""

import pytest

from forcemesh.faults import FAULTS
from services.arbiter.states import MOST_TRIPS
from tests.fakes.cellmates import Cellmates
from tests.fakes.provoked import IN_MOTION

# Faults that several messages are needed for.
PERIODS = {"misaligned": 2, "bad_messages": 6}
# Reported by age alone, at the deadline of each topic: swept in test_service.py.
BY_AGE = {"missing", "stale"}
# Faults of a process that restarts before its topic is stale: test_core.py.
BY_WRITER = {"writer"}
# Limits of set points and of commanders, and the regulator's reports of its own contact: they
# stop a present motion in the period in which they are found (test_arbiter_*.py).
IN_THE_STREAM = {
    "unreachable",
    "joint", "step", "tether", "speed", "travel", "oscillation", "sensor_sign", "no_lease",
    "preempted", "handover", "back_off", "still_loaded",
    "monitor_speed", "delay",
}  # fmt: skip


@pytest.mark.parametrize("code", IN_MOTION)
def test_a_fault_is_reported_in_the_first_possible_period(code: str) -> None:
    """Swept: for each code of the list the permission ends, and the status is of this period."""
    cell = Cellmates().arm()
    IN_MOTION[code](cell)
    for _ in range(PERIODS.get(code, 1)):
        if code not in cell.codes():
            cell.step()
    status = cell.status.read(cell.clock.now_ns())
    assert code in cell.codes()
    assert status.age_s == 0.0
    assert (cell.published().permission is None) == (code != "goal_refused")
    (trip,) = [trip for trip in cell.last_status().trips if trip.code == code]
    assert trip.rule == FAULTS[code].rule
    assert trip.text


def test_every_trip_is_in_one_of_the_lists() -> None:
    """A new code needs a test of its time, or a reference to another test."""
    stops = {fault.code for fault in FAULTS.values() if fault.kind != "REFUSAL"}
    lists = [set(IN_MOTION), BY_AGE, BY_WRITER, IN_THE_STREAM]
    assert set().union(*lists) == stops
    assert sum(map(len, lists)) == len(stops)


def test_a_second_cause_is_reported_at_once_too() -> None:
    """With the arm already stopped, the status still does not wait for its rate."""
    cell = Cellmates().arm()
    for number, code in enumerate(["hold"] * MOST_TRIPS, start=1):
        IN_MOTION[code](cell)
        assert cell.status.read(cell.clock.now_ns()).age_s == 0.0
        assert len(cell.last_status().trips) == number
