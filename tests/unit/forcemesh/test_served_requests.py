"""Requests that a role has served, as it publishes them: content, order, size and rate."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcemesh import topics
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.codec import (
    Envelope,
    decode_envelope,
    decode_record,
    encode_record,
)
from forcemesh.errors import DataError
from forcemesh.requests import Empty, HoldRequest, Reply, ServedRequest
from forcemesh.served_requests import MOST_PER_S, request_data
from forcemesh.topics import REQUESTS, Request
from tests.fakes.records import records
from tests.unit.forcemesh.test_inbox import RequestServer


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


def test_texts_of_four_bytes_per_character_fit() -> None:
    """The largest request, reply and sender that can be decoded."""
    server, text = RequestServer(topics.HOLD), "\U0001f916" * 500
    server.serve(
        encode_record(HoldRequest(reason=text), Envelope(sender=text[:400])),
        Reply(accepted=True, text=text),
    )
    (served,) = server.published()
    assert served.payload
    assert served.reply is not None
    assert text.startswith(served.reply.text)


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


def test_a_payload_that_is_no_map_is_an_error_when_it_is_sent_again() -> None:
    """An altered recording ends in a message, not in a traceback."""
    for payload in ("[1]", "{", "7"):
        with pytest.raises(DataError, match="request/hold: its payload cannot be read"):
            request_data(ServedRequest(request="request/hold", payload=payload), "", ManualClock())
    served = ServedRequest(request="request/hold", payload="zz", fault="no map")
    with pytest.raises(DataError, match="request/hold"):
        request_data(served, "", ManualClock())
