"""The recorder on a bus in memory and a clock of the test, and its files."""

import tempfile
from pathlib import Path
from typing import Any

from common.bus.memory_bus import MemoryCall, MemoryTransport
from common.config.cell import CellConfig
from common.config.load import cell_from_tree
from forcemesh import topics
from forcemesh.bus import Bus, Publisher
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.codec import decode_record, encode_record
from forcemesh.messages import ArbiterState, ArbiterStatus, Message, RecorderStatus
from forcemesh.records import Record
from forcemesh.requests import Empty, RecordRequest, Reply
from forcemesh.topics import CLIENT, TOPICS, Request, Topic
from services.recorder.service import Recorder
from tests.fakes.bench import CELL

WALL_NS = 1_800_000_000 * NS_PER_S
TRIP: dict[str, Any] = {"code": "force", "rule": 408, "text": "61 N, the limit is 60 N"}


def cell_with(folder: Path, **section: Any) -> CellConfig:
    """Return the demo's cell that records into a folder."""
    tree = CELL.model_dump()
    tree["recorder"] |= {"folder": str(folder), "least_free_GB": 0.0, **section}
    return cell_from_tree(tree, "test")


class RecorderBench:
    """Publishes messages, advances the clock, sends requests to the recorder."""

    def __init__(self, folder: Path, *, name: str = "demo", **section: Any) -> None:
        """Start a recorder that records into a folder."""
        self.folder, self.wall_zero_ns = folder, WALL_NS
        self.cell = cell_with(folder, **section).model_copy(update={"cell": name})
        self.clock = ManualClock()
        self.transport = MemoryTransport()
        self.recorder = Recorder(self._bus("recorder"), self.cell, wall_ns=self.wall_ns)
        self._status = self._bus(CLIENT).reader(topics.RECORDER_STATUS)
        self._writers: dict[str, Publisher[Any]] = {}

    def wall_ns(self) -> int:
        """Return the wall clock time."""
        return self.wall_zero_ns + self.clock.now_ns()

    def send(self, topic: Topic[Any], message: Message) -> None:
        """Publish a message on a topic as its writer."""
        if topic.key not in self._writers:
            self._writers[topic.key] = self._bus(topic.writer).publisher(topic)
        self._writers[topic.key].put(message)

    def send_bytes(self, topic: Topic[Any], data: bytes) -> None:
        """Put any bytes on a key."""
        self.transport.publish(f"{self.cell.cell}/{topic.key}", topic.qos)(data)

    def pass_s(self, duration_s: float, *published: Topic[Any]) -> None:
        """Advance by a time while topics are published, each once in every step."""
        for _ in range(round(duration_s / self.recorder.period_s)):
            for topic in published or (topics.WRENCH,):
                self.send(topic, topic.message())
            self.clock.sleep_s(self.recorder.period_s)
            self.recorder.step(self.clock.now_ns())

    def trip(self, state: ArbiterState = "HOLDING", code: str = "force") -> None:
        """Trip an arm that was in motion."""
        self.send(topics.ARBITER_STATUS, ArbiterStatus(state="ACTIVE"))
        self.pass_s(0.1)
        status = ArbiterStatus.from_dict({"state": state, "trips": (TRIP | {"code": code},)})
        self.send(topics.ARBITER_STATUS, status)
        self.pass_s(0.1)

    def ask(self, request: Request[Any], message: Record) -> Reply:
        """Send a request to the recorder."""
        address = f"{self.cell.cell}/{request.key}"
        call = MemoryCall(encode_record(message))
        self.transport.serve(address).waiting.append(call)
        self.recorder.step(self.clock.now_ns())
        assert call.reply is not None
        return decode_record(call.reply, Reply)

    def start(self, **options: Any) -> Reply:
        """Send the request to record."""
        return self.ask(topics.RECORD_START, RecordRequest(**options))

    def stop(self) -> Reply:
        """Send the request to end the recording."""
        return self.ask(topics.RECORD_STOP, Empty())

    def status(self) -> RecorderStatus:
        """Return the recorder's status."""
        message = self._status.read(self.clock.now_ns()).message
        assert message is not None
        return message

    def files(self) -> list[Path]:
        """Return the recordings in its folder."""
        return sorted(self.folder.glob("*.mcap"))

    def _bus(self, role: str) -> Bus:
        return Bus(role, self.cell.cell, self.transport, self.cell, self.clock)


def record_without_space() -> str:
    """Request a recording with less free space than required; return the reply's code."""
    with tempfile.TemporaryDirectory() as folder:
        return RecorderBench(Path(folder), least_free_GB=10_000.0).start().code


def place(topic: Topic[Any]) -> int:
    """Return a topic's index in the table."""
    return TOPICS.index(topic)
