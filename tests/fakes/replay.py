"""A run as JSON lines in the format of `forcemesh watch --json`, and a regulator fed with it."""

import json
from collections.abc import Iterator
from typing import Any

from cli.verbs_watch import find_topic
from common.bus.memory_bus import MemoryCall, MemoryTransport
from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus, Reader
from forcemesh.clock import ManualClock
from forcemesh.codec import Header, encode, encode_record
from forcemesh.messages import Message
from forcemesh.records import Record
from forcemesh.topics import Request, Topic
from launch.virtual_cell import VirtualCell
from services.regulator.service import Regulator

# In the order in which they are published within one millisecond: the file keeps it.
TOPIC_ORDER: tuple[Topic[Any], ...] = (
    topics.ROBOT_STATE,
    topics.WRENCH,
    topics.REGULATOR_TARGET,
    topics.ROBOT_COMMAND,
    topics.ARBITER_STATUS,
)


def line_of(header: Header, message: Message) -> str:
    """Return the line that `forcemesh watch --json` prints for a message."""
    return json.dumps(header.as_dict() | message.as_dict())


class Capture:
    """A cell on the virtual clock with a record of every message to and from the regulator."""

    def __init__(self, cell: CellConfig) -> None:
        """Begin at the start of the cell."""
        self.world = VirtualCell(cell)
        self.lines: list[str] = []
        self._readers: list[Reader[Any]] = [self.world.client.reader(t) for t in TOPIC_ORDER]
        self._let_live = self.world.advance
        self.world.transport.advance = self.advance

    def advance(self, duration_s: float, until: Any = lambda: False) -> None:
        """Advance by milliseconds and record messages after each."""
        for _ in range(round(duration_s * 1000)):
            if until():
                return
            self._let_live(0.001)
            for reader in self._readers:
                if reader.poll():
                    reading = reader.read(self.world.clock.now_ns())
                    if reading.header is not None and reading.message is not None:
                        self.lines.append(line_of(reading.header, reading.message))

    def ask(self, request: Request[Any], message: Record) -> None:
        """Send a request and record its time."""
        if request.server == "regulator":
            entry = {"request": request.key, "stamp_ns": self.world.clock.now_ns()}
            self.lines.append(json.dumps(entry | {"fields": message.as_dict()}))
        reply = self.world.client.ask(request, message)
        assert reply.accepted, reply.text


def replay(lines: list[str], cell: CellConfig) -> Iterator[tuple[bytes, bytes]]:
    """Feed a capture through a regulator; yield each recorded target with the present one."""
    clock, transport = ManualClock(), MemoryTransport()
    regulator = Regulator(Bus("regulator", cell.cell, transport, cell, clock), cell)
    client = Bus("client", cell.cell, transport, cell, clock)
    received = client.reader(topics.REGULATOR_TARGET)
    for line in lines:
        fields = json.loads(line)
        if "request" in fields:
            request = next(r for r in topics.REQUESTS if r.key == fields["request"])
            entry = request.message.from_dict(fields["fields"])
            calls = transport.serve(f"{cell.cell}/{request.key}")
            calls.waiting.append(MemoryCall(encode_record(entry)))
            continue
        header = Header.from_dict(fields)
        topic = find_topic(header.topic.partition("/")[2])
        message = topic.message.from_dict(fields)
        if topic is not topics.REGULATOR_TARGET:
            key, data = f"{cell.cell}/{topic.key}", encode(header, message)
            transport.publish(key, topic.qos)(data)
            continue
        clock.advance_ns(header.stamp_ns - clock.now_ns())
        regulator.step(header.stamp_ns)
        now = received.read(header.stamp_ns).message
        assert now is not None
        yield message.as_json().encode(), now.as_json().encode()
