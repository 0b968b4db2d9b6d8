"""Requests that a role has served, as it publishes them: content, order, size and rate."""

import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryCall, MemoryTransport
from common.config.load import load_cell
from common.runtime.service import HealthReporter
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
from forcemesh.errors import DataError
from forcemesh.records import Record
from forcemesh.requests import Empty, HoldRequest, Reply, ServedRequest
from forcemesh.served_requests import MOST_PER_S, name_of_this_process, request_data
from forcemesh.topics import CLIENT, HEALTH, REQUESTS, SERVED, Request
from tests.fakes.records import full, records

CELL = load_cell(Path(__file__).resolve().parents[3] / "cells" / "demo.yaml")
ROOM = 1000
LONG = st.text(max_size=500)


class Server:
    """A role that serves one request, and a client that reads what it publishes."""

    def __init__(self, row: Request[Any]) -> None:
        """Serve a row of the table."""
        self.row, self.clock, self.transport = row, ManualClock(), MemoryTransport()
        self.address = f"demo/{row.key}"
        self.bus = Bus(row.server, "demo", self.transport, CELL, self.clock)
        self.inbox = self.bus.inbox(row)
        self.tap = Bus(CLIENT, "demo", self.transport, CELL, self.clock).tap(
            SERVED[row.server], ROOM
        )

    def serve(self, *requests: bytes, reply: Reply | None = None) -> list[MemoryCall]:
        """Serve raw requests."""
        calls = [MemoryCall(data) for data in requests]
        self.transport.serve(self.address).waiting.extend(calls)
        for incoming in [*self.inbox.take_all()]:
            incoming.reply(reply or Reply(accepted=True, text="done"))
        return calls

    def published(self) -> list[ServedRequest]:
        """Return the messages since the last call, each of which fits."""
        messages = []
        while (data := self.tap.take()) is not None:
            assert len(data) <= MAX_BYTES
            messages.append(decode(data, ServedRequest)[1])
        return messages


each_row = pytest.mark.parametrize("row", REQUESTS, ids=lambda row: row.key)


@each_row
def test_every_request_is_published_once_with_its_reply(row: Request[Any]) -> None:
    """Key, fields, time and reply; the request can be sent again."""
    server = Server(row)
    sent = row.message.from_dict(full(row.message))
    reply = Reply(accepted=False, code="force", text="too much", value=61.5, limit=60.0)
    envelope = Envelope(
        topic=server.address, sender="a program", boot=server.clock.boot,
        stamp_ns=server.clock.now_ns() - NS_PER_S, wait_s=3.0,
    )  # fmt: skip
    server.serve(encode_record(sent, envelope), reply=reply)
    (served,) = server.published()
    assert (served.request, served.sender, served.reply) == (row.key, "a program", reply)
    assert (served.received_ns, served.fault) == (server.clock.now_ns(), "")
    assert served.payload == sent.as_json()
    later = ManualClock(9 * NS_PER_S, boot="another")
    data = request_data(served, server.address, later)
    assert decode_record(data, row.message) == sent
    again = envelope.replaced(boot=later.boot, stamp_ns=8 * NS_PER_S)
    assert decode_envelope(data, server.address) == again  # as old as it was


@each_row
@given(data=st.data())
def test_a_request_out_of_a_message_has_the_fields_that_were_sent(
    row: Request[Any], data: st.DataObject
) -> None:
    """To the last digit, for any fields."""
    server = Server(row)
    message: Any = row.message
    sent: Record = data.draw(records(message))
    server.serve(encode_record(sent))
    (served,) = server.published()
    assert decode_record(request_data(served, "", server.clock), row.message) == sent


@given(st.binary(max_size=1000))
def test_bytes_that_are_no_request_are_kept_as_they_were(data: bytes) -> None:
    """A hold is served in spite of them, and their replay gives the same reply."""
    server = Server(topics.HOLD)
    server.serve(data)
    (served,) = server.published()
    if served.fault:
        assert request_data(served, server.address, server.clock) == data
        assert served.reply is not None
        assert served.reply.code == "malformed"


def test_a_request_that_is_refused_unread_is_published_too() -> None:
    """The service never gets it, and the refusal has the mistake."""
    server = Server(topics.CLEAR)
    server.serve(b"\xc1")
    (served,) = server.published()
    assert (served.payload, served.sender) == ("c1", "")
    assert served.fault
    assert served.reply is not None
    assert (served.reply.accepted, served.reply.code) == (False, "malformed")


@given(reason=LONG, reply=LONG, code=LONG, sender=LONG)
def test_the_longest_texts_fit_in_a_message(
    reason: str, reply: str, code: str, sender: str
) -> None:
    """Of any characters: a control loop never fails because of a long request."""
    server = Server(topics.HOLD)
    answer = Reply(accepted=True, code=code[:100], text=reply)
    server.serve(encode_record(HoldRequest(reason=reason), Envelope(sender=sender)), reply=answer)
    assert len(server.published()) == 1


def test_texts_of_four_bytes_per_character_fit() -> None:
    """The largest request, reply and sender that can be decoded."""
    server, text = Server(topics.HOLD), "\U0001f916" * 500
    server.serve(
        encode_record(HoldRequest(reason=text), Envelope(sender=text[:400])),
        reply=Reply(accepted=True, text=text),
    )
    (served,) = server.published()
    assert served.payload
    assert served.reply is not None
    assert text.startswith(served.reply.text)


def test_a_request_that_is_too_long_is_left_out_and_its_length_is_published() -> None:
    """A replay then says what it lacks."""
    server = Server(topics.CALIBRATE)
    server.serve(encode_record(topics.CALIBRATE.message(calibration_json="x" * 3000)))
    (served,) = server.published()
    assert served.payload == ""
    assert served.payload_bytes > 3000
    with pytest.raises(DataError, match=r"request/calibration of 30\d\d bytes is longer than"):
        request_data(served, server.address, server.clock)


def test_a_sender_that_is_no_text_is_none() -> None:
    """It is no reason to refuse a request."""
    server = Server(topics.HOLD)
    (call,) = server.serve(b"\x81\xa6sender\x07")
    assert server.published()[0].sender == ""
    assert call.reply is not None
    assert decode_record(call.reply, Reply).accepted


def test_the_reply_leaves_before_the_message() -> None:
    """A client must not wait for the record of its request."""
    server = Server(topics.CLEAR)
    call = MemoryCall(encode_record(Empty()))
    server.transport.serve(server.address).waiting.append(call)
    (incoming,) = server.inbox.take_all()
    replies: list[bytes | None] = []
    source = server.transport.subscribe(f"demo/{SERVED['arbiter'].key}", ROOM)
    source.waiting = Notes(lambda: replies.append(call.reply))  # type: ignore[assignment]
    incoming.reply(Reply(accepted=True))
    assert replies == [call.reply]
    assert call.reply is not None


class Notes:
    """A queue that calls a function at each message."""

    def __init__(self, note: Any) -> None:
        """Call a function."""
        self.append = lambda _: note()


def test_a_flood_is_counted_and_not_published() -> None:
    """Within a second at most so many, all of them in the count; the next message has the rest."""
    server = Server(topics.CLEAR)
    for _ in range(3 * MOST_PER_S):
        server.serve(encode_record(Empty()))
    assert len(server.published()) == MOST_PER_S
    server.clock.advance_ns(NS_PER_S)
    server.serve(encode_record(Empty()))
    server.serve(encode_record(Empty()))
    first, second = server.published()
    assert (first.skipped, second.skipped) == (2 * MOST_PER_S, 0)
    assert server.bus.requests_served == 3 * MOST_PER_S + 2


def test_without_a_request_nothing_is_published() -> None:
    """An idle loop has no more work than before."""
    server = Server(topics.CLEAR)
    assert [*server.inbox.take_all()] == []
    assert server.published() == []


def test_the_requests_of_one_role_are_numbered_together() -> None:
    """One publisher for all of them: their order is that of the sequence numbers."""
    server = Server(topics.CLEAR)
    other = server.bus.inbox(topics.HOLD)
    server.serve(encode_record(Empty()))
    server.transport.serve("demo/request/hold").waiting.append(MemoryCall(b"\x80"))
    for incoming in other.take_all():
        incoming.reply(Reply(accepted=True))
    keys = [served.request for served in server.published()]
    assert keys == ["request/clear", "request/hold"]


@pytest.mark.parametrize(("role", "expected"), [("arbiter", 1), ("hub", None)])
def test_health_has_the_number_of_requests_of_a_role_that_serves_any(
    role: str, expected: int | None
) -> None:
    """A recording then shows whether requests were served before it began."""
    clock, transport = ManualClock(), MemoryTransport()
    bus = Bus(role, "demo", transport, CELL, clock)
    if role == "arbiter":
        inbox = bus.inbox(topics.CLEAR)
        transport.serve("demo/request/clear").waiting.append(MemoryCall(b"\x80"))
        for incoming in inbox.take_all():
            incoming.reply(Reply(accepted=True))
    tap = Bus(CLIENT, "demo", transport, CELL, clock).tap(HEALTH[role], ROOM)
    HealthReporter(bus, CELL).stepped(clock.now_ns(), 0.0, Idle())
    data = tap.take()
    assert data is not None
    assert decode(data, HEALTH[role].message)[1].counters.get("requests") == expected


class Idle:
    """A service that does nothing."""

    period_s, trigger, fault = 1.0, None, ""

    def step(self, now_ns: int) -> None:
        """Do nothing."""

    def counters(self) -> dict[str, int]:
        """There are no counters."""
        return {}


def test_a_client_names_its_process() -> None:
    """Its own account: on a bus without certificates it is not verified."""
    server = Server(topics.CLEAR)

    def live(_timeout_s: float, _until: Any) -> None:
        for incoming in server.inbox.take_all():
            incoming.reply(Reply(accepted=True))

    server.transport.advance = live
    Bus(CLIENT, "demo", server.transport, CELL, server.clock).ask(topics.CLEAR, Empty())
    (served,) = server.published()
    assert served.sender == name_of_this_process()
    assert str(os.getpid()) in served.sender


def test_a_payload_that_is_no_map_is_an_error_when_it_is_sent_again() -> None:
    """An altered recording ends in a message, not in a traceback."""
    for payload in ("[1]", "{", "7"):
        with pytest.raises(DataError, match="request/hold: its payload cannot be read"):
            request_data(ServedRequest(request="request/hold", payload=payload), "", ManualClock())
    served = ServedRequest(request="request/hold", payload="zz", fault="no map")
    with pytest.raises(DataError, match="request/hold"):
        request_data(served, "", ManualClock())
