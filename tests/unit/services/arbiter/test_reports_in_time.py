"""From a fault to its name on arbiter/status: one period and the status at once (R21)."""

import pytest

from forcemesh.faults import FAULTS
from services.arbiter.reports import MOST_TRIPS
from tests.fakes.cellmates import Cellmates
from tests.fakes.provoked import IN_MOTION

# What takes several messages to be known at all.
PERIODS = {"misaligned": 2, "bad_messages": 6}
# Told by age alone, at the deadline of each topic: swept in test_service.py.
BY_AGE = {"missing", "stale"}
# Needs a process that restarts faster than its topic grows stale: test_core.py.
BY_WRITER = {"writer"}
# Limits of set points and of who commands, and what the regulator says of its own contact: they
# stop a motion that is under way, in the period in which they are found (test_arbiter_*.py).
IN_THE_STREAM = {
    "joint", "step", "tether", "speed", "travel", "oscillation", "sensor_sign", "no_lease",
    "preempted", "handover", "back_off", "still_loaded",
    "monitor_speed", "delay",
}  # fmt: skip


@pytest.mark.parametrize("code", IN_MOTION)
def test_a_fault_is_named_in_the_period_in_which_it_can_be_known(code: str) -> None:
    """Swept: each code of the list; the permission ends, the status is of this very period."""
    cell = Cellmates().arm()
    IN_MOTION[code](cell)
    for _ in range(PERIODS.get(code, 1)):
        if code not in cell.codes():
            cell.step()
    status = cell.status.read(cell.clock.now_ns())
    assert code in cell.codes()
    assert status.age_s == 0.0
    assert (cell.said().permission is None) == (code != "goal_refused")
    (trip,) = [trip for trip in cell.told().trips if trip.code == code]
    assert trip.rule == FAULTS[code].rule
    assert trip.text


def test_every_stop_is_in_one_of_the_lists() -> None:
    """A new row of the dictionary must be proved to be told in time, or be said to be elsewhere."""
    stops = {fault.code for fault in FAULTS.values() if fault.kind != "REFUSAL"}
    lists = [set(IN_MOTION), BY_AGE, BY_WRITER, IN_THE_STREAM]
    assert set().union(*lists) == stops
    assert sum(map(len, lists)) == len(stops)


def test_a_second_cause_is_told_at_once_too() -> None:
    """While the arm is stopped already: the status does not wait for its rate."""
    cell = Cellmates().arm()
    for number, code in enumerate(["hold"] * MOST_TRIPS, start=1):
        IN_MOTION[code](cell)
        assert cell.status.read(cell.clock.now_ns()).age_s == 0.0
        assert len(cell.told().trips) == number
