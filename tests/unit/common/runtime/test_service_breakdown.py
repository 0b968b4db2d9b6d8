"""An error that a service does not foresee becomes a named fault; the process lives on."""

import pytest

from common.runtime.service import BREAKDOWN_SHOWN_NS, Containment, HealthReporter, Runner
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.errors import BusError
from forcemesh.messages import Health, Trip
from forcemesh.requests import ArmRequest, Empty
from tests.fakes.bench import CELL
from tests.fakes.cellmates import Cellmates
from tests.fakes.lab import Lab

ERRORS = [ValueError("1e+200"), OverflowError(), RecursionError("deep"), BusError("x")]


class FailingService:
    """A service that breaks off when the test sets an error."""

    period_s = 0.004
    trigger = None
    fault = ""

    def __init__(self) -> None:
        """Start well."""
        self.error: Exception | None = None
        self.trips: list[Trip] = []
        self.steps = 0

    def step(self, _now_ns: int) -> None:
        """Count, then break off."""
        self.steps += 1
        if self.error is not None:
            raise self.error

    def counters(self) -> dict[str, int]:
        """There are no counters."""
        return {}

    def broke_off(self, trip: Trip) -> None:
        """Remember."""
        self.trips.append(trip)


@pytest.mark.parametrize("error", ERRORS, ids=repr)
def test_an_unforeseen_error_is_reported_at_once_and_the_process_continues(
    error: Exception,
) -> None:
    """Health names it in the same step; two seconds after the last one it is well again."""
    cell, failing = Cellmates(), FailingService()
    log: list[str] = []
    bus = cell._bus("wrench")
    reader = cell.client.reader(topics.HEALTH["wrench"])
    contain = Containment("wrench", log.append)
    runner = Runner(failing, [HealthReporter(bus, CELL)], cell.clock, contain=contain)

    def health() -> Health:
        cell.clock.sleep_s(0.004)
        runner.step(cell.clock.now_ns())
        message = reader.read(cell.clock.now_ns()).message
        assert message is not None
        return message

    assert health().valid
    failing.error = error
    report = health()
    assert (report.valid, report.code) == (False, "internal")
    assert report.reason == report.fault
    assert type(error).__name__ in report.reason
    assert "test_service_breakdown.py" in report.reason
    for _ in range(100):
        health()
    assert failing.steps == 102
    assert contain.breakdowns == 101
    assert len(log) == 1, "one trace a second, however often it comes"
    assert "Traceback" in log[0]
    assert {trip.code for trip in failing.trips} == {"internal"}
    failing.error = None
    cell.clock.sleep_s(BREAKDOWN_SHOWN_NS / NS_PER_S)
    assert health().valid


def test_without_a_containment_it_is_raised() -> None:
    """Virtual cells and tests see their errors."""
    cell, failing = Cellmates(), FailingService()
    runner = Runner(failing, [HealthReporter(cell._bus("wrench"), CELL)], cell.clock)
    failing.error = ValueError("raised")
    with pytest.raises(ValueError, match="raised"):
        runner.step(cell.clock.now_ns())


@pytest.mark.parametrize("role", ["hub", "robot", "wrench", "regulator"])
def test_the_arm_goes_to_fault_when_another_process_breaks_off(role: str) -> None:
    """Under its own code, with the process's text; a person clears and arms."""
    cell = Cellmates().arm()
    well = cell.messages[f"{role}/health"]
    text = f"{role}: ValueError at law.py:7: 1e+200"
    cell.change(f"{role}/health", valid=False, code="internal", reason=text)
    cell.step()
    assert cell.last_status().state == "FAULT"
    assert cell.codes() == ["internal"]
    assert text in cell.last_status().trips[0].text
    assert cell.published().permission is None
    assert not cell.ask(topics.CLEAR, Empty()).accepted
    cell.messages[f"{role}/health"] = well
    cell.pass_s(1.1)
    assert cell.ask(topics.CLEAR, Empty()).accepted
    assert cell.ask(topics.ARM, ArmRequest()).accepted


@pytest.mark.parametrize("role", ["arbiter", "regulator", "wrench", "robot"])
def test_a_pressing_arm_holds_when_a_step_of_any_service_breaks_off(
    role: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One error in one step of a whole cell: FAULT, and nothing moves before a person arms."""
    lab = Lab()
    lab.approach()
    runner = lab.cell.runners[role]
    runner._contain = Containment(role, lambda _text: None)
    step, left = runner.service.step, [1]

    def once(now_ns: int) -> None:
        if left:
            left.pop()
            raise OverflowError("cannot convert float infinity to integer")
        step(now_ns)

    monkeypatch.setattr(runner.service, "step", once)
    lab.cell.advance(0.06)
    assert lab.status.state == "FAULT"
    assert lab.status.trips[-1].code == "internal"
    assert "OverflowError" in lab.status.trips[-1].text
    lab.cell.advance(0.25)
    lab.assert_still(0.3)
