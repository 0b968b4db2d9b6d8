"""Ownership of force control: one client at a time, a higher rank takes it, any client stops it."""

from typing import Any

import pytest

from control.gain_rule import instability, tune
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.requests import Empty, ForceStartRequest, GainsRequest, PathRequest, Reply
from forcemesh.topics import CLIENT
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import KI, RegulatorBench

CHANGES: dict[str, tuple[topics.Request[Any], Any]] = {
    "set point": (topics.FORCE_START, ForceStartRequest(setpoint_N=20.0)),
    "gains": (topics.GAINS, GainsRequest(force_i_m_per_Ns=(KI, KI, 0.5 * KI))),
    "path": (topics.FORCE_PATH, PathRequest()),
}


class Client:
    """A client with its own connection, rank and name."""

    def __init__(self, bench: RegulatorBench, rank: str, name: str) -> None:
        """Connect."""
        bus = Bus(CLIENT, CELL.cell, bench.transport, CELL, bench.clock, client=name)
        self._bus, self._rank = bus, rank

    def ask(self, request: topics.Request[Any], message: Any) -> Reply:
        """Send a request."""
        return self._bus.ask(request, message.replaced(commander=self._rank))

    def start(self) -> Reply:
        """Start force control."""
        return self.ask(topics.FORCE_START, ForceStartRequest(setpoint_N=8.0))


@pytest.fixture
def bench() -> RegulatorBench:
    """A regulator that is armed."""
    bench = RegulatorBench()
    bench.step()
    return bench


@pytest.mark.parametrize("what", CHANGES)
@pytest.mark.parametrize("owner", ["operator", "program"])
@pytest.mark.parametrize("asker", ["operator", "program"])
@pytest.mark.parametrize("name", ["a", "b"])
def test_only_the_owner_and_a_higher_rank_change_force_control(bench, owner, asker, name, what):
    """Every pair of ranks, the same client and another one; the refusal names the owner."""
    assert Client(bench, owner, "a").start().accepted
    before = bench.after_step(topics.REGULATOR_TARGET).setpoint_N
    reply = Client(bench, asker, name).ask(*CHANGES[what])

    is_owner = (asker, name) == (owner, "a")
    may = is_owner or (asker, owner) == ("operator", "program")
    assert (reply.accepted, reply.code) == (may, "ok" if may else "busy")
    now = bench.after_step(topics.REGULATOR_TARGET).setpoint_N
    assert now == (20.0 if may and what == "set point" else before)
    if not may:
        assert f"belongs to the {owner} a" in reply.text
    elif not is_owner:  # it owns force control now
        assert Client(bench, owner, "a").start().code == "busy"
        assert Client(bench, asker, name).start().accepted


@pytest.mark.parametrize("end", ["stop", "hold"])
def test_any_client_ends_force_control_and_the_next_may_start(bench, end) -> None:
    """By a stop, and when the arm is held; not by time, nor by a question for the gains."""
    assert Client(bench, "operator", "a").start().accepted
    bench.pass_s(5.0)
    program = Client(bench, "program", "b")
    asked = program.ask(topics.GAINS, GainsRequest())
    assert (asked.accepted, asked.gains) == (True, tune(CELL).gains)
    assert program.start().code == "busy"
    if end == "stop":
        assert bench.ask(topics.FORCE_STOP, Empty()).accepted
    else:
        armed = bench.arbiter
        bench.arbiter = armed.replaced(state="HOLDING")
        bench.step(2)
        bench.arbiter = armed
        bench.step(2)
    assert program.start().accepted


def test_gains_that_the_rule_calls_unstable_are_refused_unless_they_are_accepted(bench) -> None:
    """Nothing changes; with the explicit word of a person they are set, and named as unstable."""
    asked = GainsRequest(force_i_m_per_Ns=(0.0, 0.0, 20.0 * KI))
    reply = bench.ask(topics.GAINS, asked)
    assert (reply.accepted, reply.code, reply.gains) == (False, "unstable_gains", tune(CELL).gains)
    reply = bench.ask(topics.GAINS, asked.replaced(accept_unstable=True))
    assert reply.accepted
    assert reply.gains is not None
    assert reply.gains.force_i_m_per_Ns == (0.0, 0.0, 20.0 * KI)
    assert reply.text == instability(CELL, reply.gains)
    assert bench.ask(topics.GAINS, GainsRequest()).text == reply.text
