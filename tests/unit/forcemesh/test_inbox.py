"""Requests: refused, late, or executed once; those that stop always; and as they are published."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryCall, MemoryTransport
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.codec import (
    MAX_BYTES,
    Envelope,
    decode,
    decode_envelope,
    decode_record,
    encode_record,
)
from forcemesh.errors import BusError, DataError
from forcemesh.force_task import GUIDED, parse_task
from forcemesh.messages import Health
from forcemesh.records import Record
from forcemesh.requests import (
    ArmRequest,
    Empty,
    ForceStartRequest,
    HoldRequest,
    Reply,
    ServedRequest,
)
from forcemesh.served_requests import MOST_PER_S, request_data
from forcemesh.topics import CLIENT, HEALTH, REQUESTS, SERVED, Request
from tests.fakes.bench import CELL
from tests.fakes.records import full, records

DONE = Reply(accepted=True, text="done")
NO_REQUEST = st.binary(max_size=60).filter(lambda data: data != b"\x80")
ALWAYS = (topics.HOLD, topics.FORCE_STOP)
STEP_NS = 20_000_000
TICKS = st.integers(0, 400)  # of an age


def bus_of(role: str, transport: MemoryTransport | None = None) -> Bus:
    """Return a role's view of the demo cell."""
    return Bus(role, "demo", transport or MemoryTransport(), CELL, ManualClock())


class RequestServer:
    """A role that serves one request, with clients on its own clock and on another one."""

    def __init__(self, row: Request[Any]) -> None:
        """Serve a row of the table."""
        self.row, self.transport = row, MemoryTransport()
        self.address = f"demo/{row.key}"
        self.bus = bus_of(row.server, self.transport)
        self.clock: Any = self.bus.clock
        self.elsewhere = ManualClock(10**15, boot="elsewhere")
        self.inbox = self.bus.inbox(row)
        self.health = self.bus.publisher(HEALTH[row.server])
        self.requests: list[Record] = []
        self.tap = bus_of(CLIENT, self.transport).tap(SERVED[row.server], 1000)
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
        self.clock.advance_ns(duration_ns)
        self.elsewhere.advance_ns(duration_ns)

    def step(self, reply: Reply = DONE) -> None:
        """Serve what has come."""
        for incoming in self.inbox.take_all():
            self.requests.append(incoming.request)
            incoming.reply(reply)

    def send(self, data: bytes) -> MemoryCall:
        """Queue a raw request."""
        call = MemoryCall(data)
        self.transport.serve(self.address).waiting.append(call)
        return call

    def send_full(self, envelope: Envelope) -> MemoryCall:
        """Queue a request with every field set."""
        message = self.row.message.from_dict(full(self.row.message))
        return self.send(encode_record(message, envelope.replaced(topic=self.address)))

    def serve(self, data: bytes, reply: Reply = DONE) -> Reply:
        """Serve a raw request; return the reply."""
        call = self.send(data)
        self.step(reply)
        return reply_of(call)

    def published(self) -> list[ServedRequest]:
        """Return the messages since the last call, each of which fits."""
        messages = []
        while (data := self.tap.take()) is not None:
            assert len(data) <= MAX_BYTES
            messages.append(decode(data, ServedRequest)[1])
        return messages


def reply_of(call: MemoryCall) -> Reply:
    """Return the reply to a request."""
    assert call.reply is not None
    return decode_record(call.reply, Reply)


# --- what decodes, and what does not --------------------------------------------------------------


@given(NO_REQUEST)
def test_a_request_that_does_not_decode_is_refused_on_the_spot(data: bytes) -> None:
    """The service never gets it, the client receives the mistake, and both are published."""
    server = RequestServer(topics.RECORD_START)
    reply = server.serve(data)
    (served,) = server.published()
    assert server.requests == []
    assert (reply.accepted, reply.code) == (False, "malformed")
    assert reply.text
    assert served.fault
    assert served.reply is not None
    assert served.reply.code == "malformed"


@given(NO_REQUEST)
def test_a_hold_that_does_not_decode_is_served_and_complained_of(data: bytes) -> None:
    """Whatever the bytes are; published as they were, their replay gives the same reply."""
    server = RequestServer(topics.HOLD)
    reply = server.serve(data)
    (served,) = server.published()
    assert [type(each) for each in server.requests] == [HoldRequest]
    assert (reply.accepted, reply.code) == (True, "malformed")
    assert reply.text.startswith("done; the request itself cannot be decoded: ")
    assert request_data(served, server.address, server.clock) == data
    assert served.reply is not None


def test_an_empty_map_is_a_request_with_all_its_defaults() -> None:
    """The smallest hold that any language can send is one byte; a sender is a text, or none."""
    server = RequestServer(topics.HOLD)
    assert server.serve(b"\x80") == DONE
    assert server.requests == [HoldRequest()]
    assert server.serve(b"\x81\xa6sender\x07").accepted
    assert server.published()[-1].sender == ""


def test_requests_are_taken_in_order_and_a_bad_one_stops_none_behind_it() -> None:
    """Everything that has come in is served in one go, each gets its own answer."""
    server = RequestServer(topics.RECORD_START)
    calls = [server.send(d) for d in (b"\x81\xa5label\xa1a", b"\xc1", b"\x81\xa5label\xa1b")]
    server.step()
    assert [request.as_dict()["label"] for request in server.requests] == ["a", "b"]
    assert [reply_of(call).code for call in calls] == ["ok", "malformed", "ok"]


def test_an_answer_that_never_comes_is_an_error_that_names_the_server() -> None:
    """No server, or a dead one: the client is not left hanging."""
    unserved, dead = MemoryTransport(), MemoryTransport()
    bus_of("arbiter", dead).inbox(topics.ARM)
    dead.advance = lambda _timeout_s, _until: None
    for transport in (unserved, dead):
        with pytest.raises(BusError, match="arbiter did not answer demo/request/arm within 2 s"):
            bus_of(CLIENT, transport).ask(topics.ARM, ArmRequest())


# --- age ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", REQUESTS, ids=lambda row: row.key)
@given(
    wait=st.integers(25, 250), ticks=TICKS, is_frozen=st.booleans(),
    clock=st.sampled_from(["here", "elsewhere", "none"]),
)  # fmt: skip
def test_no_request_older_than_its_wait_is_executed_except_those_that_stop(
    row: Request[Any], wait: int, ticks: int, clock: str, is_frozen: bool
) -> None:
    """It waits in the network or in the queue of a frozen server, and then leaves no trace."""
    server, wait_s, age_s = RequestServer(row), wait * 0.02, ticks * 0.02
    server.live(0.3)
    status = server.health.put(Health())
    stamps = {
        "here": Envelope(boot=server.clock.boot, stamp_ns=server.clock.now_ns(), wait_s=wait_s),
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
    call = server.send_full(stamps[clock])
    server.step()

    is_old = clock != "none" and ticks > wait
    if row in ALWAYS:
        assert len(server.requests) == 1
    elif is_old or (is_frozen and ticks > 25):
        assert (server.requests, reply_of(call).code) == ([], "late")
    else:
        assert (len(server.requests), reply_of(call).accepted) == (1, True)


def test_what_the_network_held_during_a_freeze_is_not_executed_either() -> None:
    """It arrives in the first tenth of a second after; what arrives later is new."""
    server = RequestServer(topics.SIGNAL)
    server.advance_ns(3 * NS_PER_S)
    server.step()
    calls = []
    for _ in range(20):
        calls.append(server.send_full(Envelope()))
        server.live(0.02)
    codes = [reply_of(call).code for call in calls]
    assert codes == ["late"] * codes.count("late") + ["ok"] * codes.count("ok")
    assert codes.count("late") == 4


@pytest.mark.parametrize("status", [(0, 0), (1, 1)])
def test_a_request_from_another_clock_that_names_no_status_of_this_server_is_late(
    status: tuple[int, int],
) -> None:
    """None at all, or that of a process that is gone: nothing bounds its age."""
    server = RequestServer(topics.CLEAR)
    server.live(0.3)
    there = Envelope(boot="elsewhere", status_epoch=status[0], status_seq=status[1])
    call = server.send_full(there)
    server.step()
    assert (server.requests, reply_of(call).code) == ([], "late")


def test_a_request_that_is_late_on_the_servers_own_clock_is_not_repeated() -> None:
    """The server was frozen: a newer status of it changes nothing."""
    server = RequestServer(topics.CLEAR)
    server.advance_ns(3 * NS_PER_S)
    client = Bus(CLIENT, CELL.cell, server.transport, CELL, server.clock)
    assert client.ask(topics.CLEAR, Empty()).code == "late"
    assert (server.requests, len(server.published())) == ([], 1)


def test_a_client_on_another_clock_names_the_status_that_it_has_received(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its first request is refused, and repeated with the health that it then receives."""
    server = RequestServer(topics.CLEAR)
    monkeypatch.setattr(server.elsewhere, "sleep_s", lambda s: server.live(max(s, 0.02)))
    client = Bus(CLIENT, CELL.cell, server.transport, CELL, server.elsewhere)
    assert client.ask(topics.CLEAR, Empty()).accepted
    assert client.ask(topics.CLEAR, Empty()).accepted
    replies = [served.reply.code for served in server.published() if served.reply is not None]
    assert replies == ["late", "ok", "ok"]


@pytest.mark.parametrize("row", REQUESTS, ids=lambda row: row.key)
@given(data=st.data())
def test_every_request_is_published_once_with_its_reply(
    row: Request[Any], data: st.DataObject
) -> None:
    """Key, fields to the last digit, time and reply; the request can be sent again."""
    server = RequestServer(row)
    message: Any = row.message
    sent: Any = data.draw(records(message))
    reply = Reply(accepted=False, code="force", text="too much", value=61.5, limit=60.0)
    envelope = Envelope(topic=server.address, sender="a program", wait_s=3.0)
    stamp = {"boot": server.clock.boot, "stamp_ns": server.clock.now_ns() - NS_PER_S}
    stamp = data.draw(st.sampled_from([stamp, {}]))
    server.serve(encode_record(sent, envelope.replaced(**stamp)), reply)
    (served,) = server.published()
    assert (served.request, served.sender, served.reply) == (row.key, "a program", reply)
    assert (served.received_ns, served.fault) == (server.clock.now_ns(), "")
    later = ManualClock(9 * NS_PER_S, boot="another")
    again = request_data(served, server.address, later)
    assert decode_record(again, message) == sent
    as_old = envelope.replaced(boot=later.boot, stamp_ns=8 * NS_PER_S) if stamp else envelope
    assert decode_envelope(again, server.address) == as_old


def test_a_recorded_task_has_the_words_of_today() -> None:
    """Compliant axes were `admittance` or `free`, and hand guiding was a law."""
    server = RequestServer(topics.FORCE_START)
    server.serve(encode_record(ForceStartRequest(task=parse_task("x=compliant z=force:5"))))
    (served,) = server.published()
    for old in ("free", "admittance"):
        recorded = served.replaced(payload=served.payload.replace("compliant", old))
        again = request_data(recorded, server.address, server.clock)
        task = decode_record(again, ForceStartRequest).task
        assert task == parse_task("x=compliant z=force:5")
    server.serve(encode_record(ForceStartRequest(mode="both", law="admittance")))
    again = request_data(server.published()[-1], server.address, server.clock)
    request = decode_record(again, ForceStartRequest)
    assert (request.law, request.task) == ("plain", parse_task(GUIDED["both"]))


def test_a_request_that_is_too_long_is_left_out_and_its_length_is_published() -> None:
    """A replay then says what it lacks."""
    server = RequestServer(topics.CALIBRATE)
    server.serve(encode_record(topics.CALIBRATE.message(calibration_json="x" * 3000)))
    (served,) = server.published()
    assert served.payload == ""
    assert served.payload_bytes > 3000
    with pytest.raises(DataError, match=r"request/calibration of 30\d\d bytes is longer than"):
        request_data(served, server.address, server.clock)


def test_a_flood_is_counted_and_not_published() -> None:
    """Within a second at most so many, all of them in the count; the next message has the rest."""
    server = RequestServer(topics.CLEAR)
    for _ in range(3 * MOST_PER_S):
        server.serve(encode_record(Empty()))
    assert len(server.published()) == MOST_PER_S
    server.clock.advance_ns(NS_PER_S)
    server.serve(encode_record(Empty()))
    server.serve(encode_record(Empty()))
    first, second = server.published()
    assert (first.skipped, second.skipped) == (2 * MOST_PER_S, 0)
    assert server.bus.requests_served == 3 * MOST_PER_S + 2


def test_the_reply_leaves_before_the_message(monkeypatch: pytest.MonkeyPatch) -> None:
    """A client must not wait for the record of its request."""
    server, before = RequestServer(topics.CLEAR), list[int]()
    answer = lambda _call, _data: before.append(len(server.published()))  # noqa: E731
    monkeypatch.setattr(MemoryCall, "answer", answer)
    server.send(encode_record(Empty()))
    server.step()
    assert (before, len(server.published())) == ([0], 1)
