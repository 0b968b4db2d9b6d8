"""Requests and their answers: those that a service gets, those it never gets, and the replies."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryCall, MemoryTransport
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.codec import MAX_BYTES, decode, decode_record
from forcemesh.errors import BusError, MessageError
from forcemesh.records import Record
from forcemesh.requests import ArmRequest, HoldRequest, Reply, ServedRequest
from forcemesh.served_requests import request_data
from forcemesh.topics import CLIENT, SERVED, Request
from tests.fakes.bench import CELL

DONE = Reply(accepted=True, text="done")
NO_REQUEST = st.binary(max_size=60).filter(lambda data: data != b"\x80")


def bus_of(role: str, transport: MemoryTransport | None = None) -> Bus:
    """Return a role's view of the demo cell."""
    return Bus(role, "demo", transport or MemoryTransport(), CELL, ManualClock())


class RequestServer:
    """A role that serves one request, and a client that reads what it publishes."""

    def __init__(self, row: Request[Any]) -> None:
        """Serve a row of the table."""
        self.row, self.transport = row, MemoryTransport()
        self.address = f"demo/{row.key}"
        self.bus = bus_of(row.server, self.transport)
        self.clock: Any = self.bus.clock
        self.inbox = self.bus.inbox(row)
        self.requests: list[Record] = []
        self.tap = bus_of(CLIENT, self.transport).tap(SERVED[row.server], 1000)
        self.transport.advance = lambda _timeout_s, _until: self.step()

    def step(self, reply: Reply = DONE) -> None:
        """Serve what has come."""
        for incoming in [*self.inbox.take_all()]:
            self.requests.append(incoming.request)
            incoming.reply(reply)

    def serve(self, data: bytes, reply: Reply = DONE) -> Reply:
        """Serve a raw request; return the reply."""
        call = MemoryCall(data)
        self.transport.serve(self.address).waiting.append(call)
        self.step(reply)
        assert call.reply is not None
        return decode_record(call.reply, Reply)

    def published(self) -> list[ServedRequest]:
        """Return the messages since the last call, each of which fits."""
        messages = []
        while (data := self.tap.take()) is not None:
            assert len(data) <= MAX_BYTES
            messages.append(decode(data, ServedRequest)[1])
        return messages


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
    calls = [MemoryCall(d) for d in (b"\x81\xa5label\xa1a", b"\xc1", b"\x81\xa5label\xa1b")]
    server.transport.serve(server.address).waiting.extend(calls)
    server.step()
    assert [request.as_dict()["label"] for request in server.requests] == ["a", "b"]
    codes = [decode_record(call.reply or b"", Reply).code for call in calls]
    assert codes == ["ok", "malformed", "ok"]


def test_an_answer_that_never_comes_is_an_error_that_names_the_server() -> None:
    """No server, or a dead one: the client is not left hanging."""
    unserved, dead = MemoryTransport(), MemoryTransport()
    bus_of("arbiter", dead).inbox(topics.ARM)
    dead.advance = lambda _timeout_s, _until: None
    for transport in (unserved, dead):
        with pytest.raises(BusError, match="arbiter did not answer demo/request/arm within 2 s"):
            bus_of(CLIENT, transport).ask(topics.ARM, ArmRequest())


def test_an_answer_that_is_no_reply_is_an_error() -> None:
    """The client judges its answer like any other reader."""
    transport = MemoryTransport()
    server = transport.serve("demo/request/arm")

    def live(_timeout_s: float, _until: Any) -> None:
        call = server.take()
        assert call is not None
        call.answer(b"\x93")

    transport.advance = live
    with pytest.raises(MessageError):
        bus_of(CLIENT, transport).ask(topics.ARM, ArmRequest())
