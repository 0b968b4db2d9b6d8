"""Bytes that were written for another key or another cell are refused, however well they decode."""

from pathlib import Path

import pytest

from common.bus.memory_bus import MemoryCall, MemoryTransport
from common.config.load import load_cell
from forcemesh import messages as m
from forcemesh import requests as q
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.codec import decode_record, encode
from forcemesh.errors import BusError
from tests.fakes.records import full
from tests.unit.forcemesh.conftest import Line

DEMO = Path(__file__).parents[3] / "cells" / "demo.yaml"


def test_a_message_of_another_topic_is_dropped():
    """It is neither accepted, nor does it retire the writer or spoil that one's message."""
    line = Line()
    assert line.deliver(1, m.SensorWrench(counter=5))
    header = line.header(900, epoch=2, topic="demo/wrench")
    line.source.waiting.append(encode(header, m.SensorWrench()))
    assert not line.reader.poll()
    reading = line.read()
    assert reading.fresh is not None
    assert reading.fresh.counter == 5
    assert not reading.conflict
    assert line.reader.counters.misrouted == 1
    assert line.deliver(2)


@pytest.mark.parametrize("topic", topics.TOPICS, ids=lambda topic: topic.key)
def test_a_message_of_another_cell_is_dropped(topic):
    """The bytes of one cell, delivered to the same topic of the next one, move nothing there."""
    cell, transport, clock = load_cell(DEMO), MemoryTransport(), ManualClock()
    delivered = transport.subscribe(f"left/{topic.key}")
    Bus(topic.writer, "left", transport, cell, clock).publisher(topic).put(topic.message())
    reader = Bus(topic.readers[0], "right", transport, cell, clock).reader(topic)
    data = delivered.take()
    assert data is not None
    transport.publish(f"right/{topic.key}", topic.qos)(data)
    assert not reader.poll()
    assert reader.counters.misrouted == 1
    assert "addressed to 'left/" in reader.counters.last_error


@pytest.mark.parametrize("request_row", topics.REQUESTS, ids=lambda request: request.key)
def test_a_request_to_another_cell_is_refused(request_row):
    """A request to one cell is not executed by the next one."""
    cell, transport, clock = load_cell(DEMO), MemoryTransport(), ManualClock()
    asked = request_row.message.from_dict(full(request_row.message))
    sent = []

    def deliver(_timeout_s, _until):
        call = transport.serve(f"left/{request_row.key}").take()
        assert call is not None
        sent.append(call.data)

    transport.advance = deliver
    transport.serve(f"left/{request_row.key}")
    with pytest.raises(BusError):  # no one answers: the bytes are what counts
        Bus(topics.CLIENT, "left", transport, cell, clock).ask(request_row, asked)
    inbox = Bus(request_row.server, "right", transport, cell, clock).inbox(request_row)
    call = MemoryCall(sent[0])
    transport.serve(f"right/{request_row.key}").waiting.append(call)
    for incoming in inbox.take_all():  # a hold is taken from any client, and reported
        assert request_row in (topics.HOLD, topics.FORCE_STOP)
        incoming.reply(q.Reply(accepted=True))
    assert call.reply is not None
    assert "addressed to 'left/" in decode_record(call.reply, q.Reply).text
