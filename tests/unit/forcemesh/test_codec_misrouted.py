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
from forcemesh.codec import Envelope, decode_envelope, decode_record, encode, encode_record
from forcemesh.errors import BusError, MisroutedError
from tests.fakes.line import Line
from tests.fakes.records import full

DEMO = Path(__file__).parents[3] / "cells" / "demo.yaml"
OTHERS = [topic for topic in topics.TOPICS if topic is not topics.SENSOR_WRENCH]


@pytest.mark.parametrize("other", OTHERS, ids=lambda topic: topic.key)
def test_a_message_of_another_topic_is_dropped(other):
    """It is neither accepted, nor does it retire the writer or spoil that one's message."""
    line = Line()
    assert line.deliver(1, m.SensorWrench(counter=5))
    header = line.header(900, epoch=2, topic=f"demo/{other.key}")
    line.source.waiting.append(encode(header, other.message()))
    assert not line.reader.poll()
    reading = line.read()
    assert reading.fresh is not None
    assert reading.fresh.counter == 5
    assert not reading.conflict
    assert line.reader.counters.misrouted == 1
    assert line.deliver(2)


def test_a_topic_on_which_hardly_anything_else_comes_is_not_orderly():
    """A stray now and then is nothing; strays all the time are a fault."""
    line = Line()
    assert line.deliver(1)
    for seq in range(10):
        line.deliver(seq, topic="demo/wrench")
    reading = line.read()
    assert reading.code == "bad_messages"
    assert "10 addressed to another topic or cell" in reading.fault


@pytest.mark.parametrize("other", topics.REQUESTS, ids=lambda request: request.key)
def test_a_request_for_something_else_is_refused(other):
    """A hold that came to the key of `arm` would otherwise arm."""
    sent = Envelope(topic=f"demo/{topics.HOLD.key}")
    data = encode_record(q.HoldRequest(), sent)
    if other is topics.HOLD:
        assert decode_envelope(data, f"demo/{other.key}") == sent
        return
    with pytest.raises(MisroutedError, match="request/hold"):
        decode_envelope(data, f"demo/{other.key}")


def test_a_request_may_omit_its_address():
    """A client of another author sends the fields of the request alone."""
    assert decode_envelope(encode_record(q.Empty()), f"demo/{topics.CLEAR.key}") == Envelope()


def test_a_publisher_writes_the_address():
    """Messages of the project's own programs name their key."""
    cell, transport, clock = load_cell(DEMO), MemoryTransport(), ManualClock()
    writer = Bus("arbiter", "demo", transport, cell, clock)
    reader = Bus("robot", "demo", transport, cell, clock)
    commands = reader.reader(topics.ROBOT_COMMAND)
    writer.publisher(topics.ROBOT_COMMAND).put(m.RobotCommand())
    assert commands.poll()
    header = commands.read(clock.now_ns()).header
    assert header is not None
    assert header.topic == "demo/robot/command"


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
