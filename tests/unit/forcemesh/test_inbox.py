"""Requests and their answers: those that a service gets, those it never gets, and the replies."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryCall, MemoryTransport
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.codec import decode_record
from forcemesh.errors import BusError, MessageError
from forcemesh.messages import Trip
from forcemesh.requests import ArmRequest, HoldRequest, Reply
from forcemesh.topics import CLIENT

CELL = load_cell(Path(__file__).resolve().parents[3] / "cells" / "demo.yaml")


def bus_of(role: str, transport: MemoryTransport) -> Bus:
    """Return a role's view of the demo cell."""
    return Bus(role, "demo", transport, CELL, ManualClock())


def serve(
    *requests: bytes, row: topics.Request[Any] = topics.RECORD_START
) -> tuple[list[Any], list[Reply | None]]:
    """Receive raw bytes as requests; return the requests of the service and the replies."""
    transport = MemoryTransport()
    inbox = bus_of(row.server, transport).inbox(row)
    calls = [MemoryCall(data) for data in requests]
    transport.serve(f"demo/{row.key}").waiting.extend(calls)
    taken = []
    for incoming in inbox.take_all():
        taken.append(incoming.request)
        incoming.reply(Reply(accepted=True, text=getattr(incoming.request, "label", "held")))
    answers = [call.reply for call in calls]
    return taken, [None if data is None else decode_record(data, Reply) for data in answers]


@given(st.binary(max_size=60).filter(lambda data: data != b"\x80"))
def test_a_request_that_does_not_decode_is_refused_on_the_spot(data: bytes) -> None:
    """The service never gets it, and the client receives the mistake."""
    taken, (reply,) = serve(data)

    assert taken == []
    assert reply is not None
    assert (reply.accepted, reply.code) == (False, "malformed")
    assert reply.text


@given(st.binary(max_size=60).filter(lambda data: data != b"\x80"))
def test_a_hold_that_does_not_decode_is_served_and_complained_of(data: bytes) -> None:
    """Whatever the bytes are: the service gets a hold, and the client receives the mistake."""
    (taken,), (reply,) = serve(data, row=topics.HOLD)

    assert isinstance(taken, HoldRequest)
    assert reply is not None
    assert (reply.accepted, reply.code) == (True, "malformed")
    assert reply.text.startswith("held; the request itself cannot be decoded: ")


def test_an_empty_map_is_a_request_with_all_its_defaults() -> None:
    """The smallest hold that any language can send is one byte."""
    taken, (reply,) = serve(b"\x80", row=topics.HOLD)

    assert taken == [HoldRequest()]
    assert reply == Reply(accepted=True, text="held")


def test_requests_are_taken_in_order_and_a_bad_one_stops_none_behind_it() -> None:
    """Everything that has come in is served in one go, each gets its own answer."""
    good = [b"\x81\xa5label\xa1" + letter for letter in (b"a", b"b")]
    taken, replies = serve(good[0], b"\xc1", good[1])

    assert [request.label for request in taken] == ["a", "b"]
    assert [reply and reply.text for reply in (replies[0], replies[2])] == ["a", "b"]
    assert replies[1] is not None
    assert replies[1].code == "malformed"


def test_the_answer_comes_back_to_the_client() -> None:
    """Through the same bytes as between processes, number and limit included."""
    transport = MemoryTransport()
    inbox = bus_of("arbiter", transport).inbox(topics.ARM)
    answer = Reply(accepted=False, code="force", text="too much", value=61.5, limit=60.0)

    def live(_timeout_s: float, _until: Any) -> None:
        for incoming in inbox.take_all():
            incoming.reply(answer)

    transport.advance = live
    assert bus_of(CLIENT, transport).ask(topics.ARM, ArmRequest()) == answer


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


def test_a_trip_makes_a_refusal_that_can_be_sent() -> None:
    """The longest text that a trip may hold is not too long for a reply."""
    trip = Trip(code="c" * 500, rule=1, text="t" * 500, value=1.0, limit=2.0)

    assert Reply.from_dict({"accepted": False, **trip.as_dict()}).limit == 2.0
