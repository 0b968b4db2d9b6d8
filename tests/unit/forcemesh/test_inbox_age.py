"""Age of requests: none is executed when its client no longer waits; those that stop always are."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryCall, MemoryTransport
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.codec import Envelope, decode, decode_record, encode_record
from forcemesh.messages import Health
from forcemesh.requests import Empty, Reply, ServedRequest
from forcemesh.topics import CLIENT, HEALTH, REQUESTS, SERVED, Request
from tests.fakes.bench import CELL
from tests.fakes.records import full

ALWAYS = (topics.HOLD, topics.FORCE_STOP)
STEP_NS = 20_000_000
TICKS = st.integers(0, 400)  # of an age


class Elsewhere(ManualClock):
    """Clock of a client on another computer; while it sleeps, the server works."""

    def __init__(self, server: "Server") -> None:
        """Start at another time."""
        super().__init__(10**15, boot="elsewhere")
        self.server = server

    def sleep_s(self, duration_s: float) -> None:
        """Let the server work."""
        self.server.live(max(duration_s, STEP_NS / NS_PER_S))


class Server:
    """A role that serves one request, with clients on its own clock and on another one."""

    def __init__(self, row: Request[Any]) -> None:
        """Serve a row of the table."""
        self.row, self.transport = row, MemoryTransport()
        self.here, self.elsewhere = ManualClock(), Elsewhere(self)
        self.bus = Bus(row.server, CELL.cell, self.transport, CELL, self.here)
        self.inbox = self.bus.inbox(row)
        self.health = self.bus.publisher(HEALTH[row.server])
        self.executed = 0
        tap = Bus(CLIENT, CELL.cell, self.transport, CELL, self.here).tap(SERVED[row.server], 9)
        self.published = lambda: [decode(d, ServedRequest)[1] for d in iter(tap.take, None)]
        self.transport.advance = self.live

    def live(self, duration_s: float, until: Any = lambda: False) -> None:
        """Step every period, and publish the health."""
        for _ in range(round(duration_s * NS_PER_S / STEP_NS)):
            if until():
                return
            self.advance_ns(STEP_NS)
            self.step()
            self.health.put(Health())

    def advance_ns(self, duration_ns: int) -> None:
        """Advance both clocks, without a step."""
        self.here.advance_ns(duration_ns)
        self.elsewhere.advance_ns(duration_ns)

    def step(self) -> None:
        """Execute what is taken."""
        for incoming in self.inbox.take_all():
            self.executed += 1
            incoming.reply(Reply(accepted=True))

    def send(self, envelope: Envelope) -> MemoryCall:
        """Queue a request."""
        message = self.row.message.from_dict(full(self.row.message))
        call = MemoryCall(encode_record(message, envelope))
        self.transport.serve(f"{CELL.cell}/{self.row.key}").waiting.append(call)
        return call


def answer(call: MemoryCall) -> Reply:
    """Return the reply to a request."""
    assert call.reply is not None
    return decode_record(call.reply, Reply)


@pytest.mark.parametrize("row", REQUESTS, ids=lambda row: row.key)
@given(
    wait=st.integers(25, 250), ticks=TICKS, is_frozen=st.booleans(),
    clock=st.sampled_from(["here", "elsewhere", "none"]),
)  # fmt: skip
def test_no_request_older_than_its_wait_is_executed_except_those_that_stop(
    row: Request[Any], wait: int, ticks: int, clock: str, is_frozen: bool
) -> None:
    """It waits in the network or in the queue of a frozen server, and then leaves no trace."""
    server, wait_s, age_s = Server(row), wait * 0.02, ticks * 0.02
    server.live(0.3)
    status = server.health.put(Health())
    stamps = {
        "here": Envelope(boot=server.here.boot, stamp_ns=server.here.now_ns(), wait_s=wait_s),
        "elsewhere": Envelope(
            boot="elsewhere", stamp_ns=server.elsewhere.now_ns(), wait_s=wait_s,
            status_epoch=status.epoch, status_seq=status.seq,
        ),
        "none": Envelope(),
    }  # fmt: skip
    if is_frozen:
        server.advance_ns(round(age_s * NS_PER_S))
    else:
        server.live(age_s)
    call = server.send(stamps[clock])
    server.step()

    is_old = clock != "none" and ticks > wait
    if row in ALWAYS:
        assert server.executed == 1
    elif is_old or (is_frozen and ticks > 25):
        assert (server.executed, answer(call).code) == (0, "late")
    else:
        assert (server.executed, answer(call).accepted) == (1, True)


def test_what_the_network_held_during_a_freeze_is_not_executed_either() -> None:
    """It arrives in the first tenth of a second after; what arrives later is new."""
    server = Server(topics.SIGNAL)
    server.advance_ns(3 * NS_PER_S)
    server.step()
    calls = []
    for _ in range(20):
        calls.append(server.send(Envelope()))
        server.live(0.02)
    codes = [answer(call).code for call in calls]
    assert codes == ["late"] * codes.count("late") + ["ok"] * codes.count("ok")
    assert codes.count("late") == 4


@pytest.mark.parametrize("status", [(0, 0), (1, 1)])
def test_a_request_from_another_clock_that_names_no_status_of_this_server_is_late(
    status: tuple[int, int],
) -> None:
    """None at all, or that of a process that is gone: nothing bounds its age."""
    server = Server(topics.CLEAR)
    server.live(0.3)
    call = server.send(Envelope(boot="elsewhere", status_epoch=status[0], status_seq=status[1]))
    server.step()
    assert (server.executed, answer(call).code) == (0, "late")


def test_a_client_on_another_clock_names_the_status_that_it_has_received() -> None:
    """Its first request is refused, and repeated with the health that it then receives."""
    server = Server(topics.CLEAR)
    client = Bus(CLIENT, CELL.cell, server.transport, CELL, server.elsewhere)
    assert client.ask(topics.CLEAR, Empty()).accepted
    assert client.ask(topics.CLEAR, Empty()).accepted
    replies = [served.reply.code for served in server.published() if served.reply is not None]
    assert replies == ["late", "ok", "ok"]
