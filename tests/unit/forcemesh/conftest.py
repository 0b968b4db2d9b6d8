"""A reader of sensor/wrench with its clock, and a channel for messages to it."""

from typing import Any

import pytest

from common.bus.memory_bus import MemorySource
from forcemesh import topics
from forcemesh.bus import Reader, Reading
from forcemesh.clock import ManualClock
from forcemesh.codec import Header, encode
from forcemesh.messages import SensorWrench

STALE_S = 0.1
CELL = "demo"


class Line:
    """A reader with its clock, and a channel for messages to it."""

    def __init__(self) -> None:
        """Start without a message."""
        self.clock = ManualClock()
        self.source: MemorySource[bytes] = MemorySource()
        self.reader = Reader(topics.SENSOR_WRENCH, self.source, self.clock, STALE_S, cell=CELL)

    def header(self, seq: int, **changes: Any) -> Header:
        """Return a header written at this time on the reader's own host."""
        stamp_ns = self.clock.now_ns()
        fields = {"seq": seq, "epoch": 1, "boot": self.clock.boot, "stamp_ns": stamp_ns}
        fields |= {"topic": f"{CELL}/{self.reader.topic.key}"}
        return Header.from_dict(fields | changes)

    def deliver(self, seq: int, message: SensorWrench | None = None, **changes: Any) -> bool:
        """Put a message into the channel and poll; return whether it was accepted."""
        message = SensorWrench(counter=seq) if message is None else message
        self.source.waiting.append(encode(self.header(seq, **changes), message))
        return self.reader.poll()

    def read(self) -> Reading[SensorWrench]:
        """Return the reading at this time."""
        return self.reader.read(self.clock.now_ns())


@pytest.fixture
def line() -> Line:
    """A reader that has received nothing."""
    return Line()
