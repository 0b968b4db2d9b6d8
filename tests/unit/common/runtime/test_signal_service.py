"""Signals of the role robot on the bus: requests are judged, the state is published or unknown."""

from typing import Any

import pytest

from common.config.load import load_cell
from common.runtime.signal_service import SignalReading, SignalService
from forcemesh import topics
from forcemesh.faults import tripped
from forcemesh.messages import Trip
from forcemesh.requests import Reply, SignalRequest
from tests.fakes.bench import DEMO, Bench
from tests.fakes.signals import ALL_OFF, NAMED

KNOWN = SignalReading({9: False, 10: False, 11: False, 1001: False})


class Role:
    """The role robot, of which only the signals are there."""

    period_s, trigger, fault = 0.004, None, ""

    def __init__(self, bus: Any, cell: Any) -> None:
        """Start with a known state and no hold."""
        self.service = SignalService(bus, cell)
        self.reading = KNOWN
        self.hold: Trip | None = None
        self.switched: list[tuple[int, bool]] = []
        self.busy: Trip | None = None

    def switch(self, number: int, on: bool) -> Trip | None:
        """Record what is switched."""
        if self.busy is None:
            self.switched.append((number, on))
        return self.busy

    def step(self, now_ns: int) -> None:
        """Serve."""
        self.service.step(now_ns, self.reading, hold=self.hold, switch=self.switch)

    def counters(self) -> dict[str, int]:
        """Return none."""
        return {}


@pytest.fixture
def bench() -> Bench:
    """The role on a bus, with the named signals."""
    return Bench("robot", Role, load_cell(DEMO, {"signals": NAMED}))


def role(bench: Bench) -> Role:
    """Return the role of a bench."""
    assert isinstance(bench.service, Role)
    return bench.service


def ask(bench: Bench, signal: str, *, on: bool = True, commander: Any = "operator") -> Reply:
    """Request an output."""
    request = SignalRequest(signal=signal, on=on, commander=commander)
    return bench.ask(topics.SIGNAL, request)


def test_what_the_robot_cannot_do_now_is_refused(bench: Bench) -> None:
    """With its reason."""
    role(bench).busy = tripped("wait", "one at a time")
    reply = ask(bench, "lamp")
    assert (reply.accepted, reply.code, reply.text) == (False, "wait", "one at a time")


def test_a_change_is_published_at_once_and_else_at_the_rate(bench: Bench) -> None:
    """A reader waits for no period; an unchanged state is repeated, so that it does not expire."""
    reader = bench.watch(topics.ROBOT_SIGNALS)
    bench.step()
    first = reader.read(bench.clock.now_ns()).header
    role(bench).reading = SignalReading({**KNOWN.on, 1001: True})
    bench.step()
    second = reader.read(bench.clock.now_ns())
    assert second.message is not None
    assert second.message.on == {**ALL_OFF, "part": True}
    assert first is not None
    assert second.header is not None
    assert second.header.seq == first.seq + 1
    bench.pass_s(1.0)
    last = reader.read(bench.clock.now_ns()).header
    assert last is not None
    assert last.seq - second.header.seq == pytest.approx(bench.cell.rates.status_hz, abs=2)
