"""Contact events on the bus: from the inputs of the regulator, at each change and at the rate."""

import pytest

from forcemesh import topics
from forcemesh.codec import decode
from forcemesh.messages import ContactEvent, RegulatorTarget
from forcemesh.requests import ForceStartRequest
from services.regulator.contact_events import ContactSettings
from services.regulator.service import Regulator
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import RegulatorBench

PRESS = ForceStartRequest(mode="position", setpoint_N=5.0)
PERIOD_S = 1.0 / CELL.rates.status_hz


class ContactBench(RegulatorBench):
    """The regulator with every contact event that it has published."""

    def __init__(self) -> None:
        """Start armed, free of contact."""
        super().__init__()
        self.tap = self.client.tap(topics.CONTACT, 10_000)

    def taken(self) -> list[ContactEvent]:
        """Return the messages since the last call."""
        found = []
        while (data := self.tap.take()) is not None:
            found.append(decode(data, ContactEvent)[1])
        return found

    def states(self) -> list[str]:
        """Return the state of each message since the last call, repeated ones once."""
        return list({event.number: event.state for event in self.taken()}.values())


@pytest.fixture
def bench() -> ContactBench:
    """A regulator that has received its inputs."""
    bench = ContactBench()
    bench.pass_s(0.5)
    return bench


def test_it_is_published_at_the_status_rate_with_its_duration(bench: ContactBench) -> None:
    """Without a change the same number, and a duration that grows."""
    bench.taken()
    bench.pass_s(1.0)
    events = bench.taken()
    assert len(events) == pytest.approx(CELL.rates.status_hz, abs=4)  # whole periods of a sample
    assert {(event.number, event.state, event.valid) for event in events} == {(1, "free", True)}
    durations = [event.duration_s for event in events]
    assert durations == sorted(durations)
    assert durations[-1] - durations[0] == pytest.approx(1.0, abs=2 * PERIOD_S)


def test_a_force_without_force_feedback_is_a_contact_too(bench: ContactBench) -> None:
    """A collision in an ordinary move; each change is published in its own step."""
    bench.taken()
    bench.push((0.0, 3.0 * ContactSettings.of(CELL).touch_N, 0.0))
    event = bench.after_step(topics.CONTACT)
    assert (event.state, event.before) == ("impact", "free")
    assert event.normal == pytest.approx((0.0, 1.0, 0.0))
    assert bench.states() == ["impact"]
    bench.pass_s(0.5)
    bench.push()
    bench.pass_s(0.5)
    assert bench.states() == ["impact", "contact", "lost", "free"]


def test_with_force_feedback_the_law_decides(bench: ContactBench) -> None:
    """A force below the limit without feedback is a contact for a law that presses."""
    assert bench.start(PRESS).accepted
    bench.pass_s(0.2)
    bench.push((0.0, 0.0, 4.0))
    bench.pass_s(0.4)
    assert bench.states()[1:] == ["approach", "impact", "contact"]
    bench.push((0.0, 0.0, 0.2))
    bench.pass_s(0.05)
    target: RegulatorTarget = bench.published()
    assert target.contact == "approach"
    assert bench.states() == ["lost"]


def test_a_contact_does_not_end_with_force_feedback(bench: ContactBench) -> None:
    """The tool still rests on the surface: it is judged by the force again."""
    assert bench.start(PRESS).accepted
    bench.push((0.0, 0.0, 4.0))
    bench.pass_s(0.4)
    bench.ask(topics.FORCE_STOP, topics.FORCE_STOP.message())
    bench.pass_s(0.4)
    assert bench.states()[-1] == "contact"


@pytest.mark.parametrize("key", ["wrench", "robot/state"])
def test_without_a_valid_input_the_state_is_unknown(bench: ContactBench, key: str) -> None:
    """As soon as it is stale, at the status rate; a contact that is found later is no impact."""
    bench.push((0.0, 0.0, 20.0))
    bench.pass_s(0.5)
    bench.taken()
    bench.silent.add(key)
    bench.pass_s(1.0)
    events = [event for event in bench.taken() if event.state == "unknown"]
    assert {event.valid for event in events} == {False}
    assert {event.code for event in events} == {"stale"}
    assert events[0].reason.startswith(f"{key} stale")
    assert len(events) == pytest.approx(CELL.rates.status_hz, abs=4)
    bench.silent.clear()
    bench.pass_s(0.1)
    event = bench.taken()[-1]
    assert (event.state, event.before, event.valid) == ("contact", "unknown", True)


def test_a_wrench_that_is_not_calibrated_is_no_input(bench: ContactBench) -> None:
    """What is left of the tool's weight would be one."""
    bench.push((0.0, 0.0, 20.0))
    bench.wrench = bench.wrench.replaced(calibrated=False, calibration_fault="residual 4 N")
    event = bench.after_step(topics.CONTACT)
    assert (event.state, event.valid, event.code) == ("unknown", False, "payload")
    assert event.reason == "residual 4 N"


def test_a_replay_continues_the_contact_of_before() -> None:
    """Number, state and time of the next message follow the last one."""
    last = ContactEvent(number=7, state="free", since_ns=3_000_000_000, duration_s=0.5, slid_m=0.1)
    bench = ContactBench()
    bench.service = Regulator(bench._bus("regulator"), CELL, contact=last)
    bench.clock.advance_ns(3_500_000_000 - bench.clock.now_ns())
    bench.pass_s(3 * PERIOD_S)
    events = bench.taken()
    assert {(event.number, event.state, event.slid_m) for event in events} == {(7, "free", 0.1)}
    assert events[0].duration_s == pytest.approx(0.5 + PERIOD_S, abs=0.005)
