"""Content of a report: time series, states, stops with their remedies, topic statistics."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from cli.report.contacts import ContactLog
from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.errors import DataError, MessageError
from forcemesh.messages import ArbiterStatus, ContactEvent, Message, Trip
from forcemesh.recorded_messages import decode_recorded
from forcemesh.requests import ServedRequest
from forcemesh.topics import TOPICS
from services.panel.readout import Readout
from services.panel.watch import Snapshot
from services.recorder.reading import RecordedFile
from services.recorder.stamps import SequenceGaps

REPORT_POINTS = 3000  # of a plot: more than the pixels of a screen
STOPPED = ("HOLDING", "FAULT")
PLACES = {
    topics.ROBOT_STATE.key: "robot",
    topics.WRENCH.key: "wrench",
    topics.SENSOR_WRENCH.key: "sensor",
    topics.REGULATOR_TARGET.key: "target",
    topics.ROBOT_COMMAND.key: "command",
    topics.ARBITER_STATUS.key: "arbiter",
}
TYPES = {topic.key: topic.message for topic in TOPICS}


@dataclass(frozen=True, slots=True)
class StopEvent:
    """Stop of the arm: time and cause."""

    at_s: float
    state: str
    trip: Trip


@dataclass(slots=True)
class TopicStatistics:
    """Statistics of one topic: count, losses, gaps, rate."""

    count: int = 0
    gaps: SequenceGaps = field(default_factory=SequenceGaps)
    longest_gap_s: float = 0.0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def rate_hz(self) -> float:
        """Mean rate."""
        duration_s = (self.last_ns - self.first_ns) / NS_PER_S
        return (self.count - 1) / duration_s if duration_s > 0.0 else 0.0

    def add(self, header: Header, at_ns: int) -> None:
        """Count a message."""
        self.first_ns = self.first_ns or at_ns
        if self.count:
            self.longest_gap_s = max(self.longest_gap_s, (at_ns - self.last_ns) / NS_PER_S)
        self.gaps.saw(0, header.epoch, header.seq)
        self.count, self.last_ns = self.count + 1, at_ns


@dataclass(slots=True)
class ReportContent:
    """Content of one recording."""

    begin_ns: int
    duration_s: float
    times_s: list[float] = field(default_factory=list)
    series: dict[str, list[float]] = field(default_factory=dict)
    states: list[tuple[float, str]] = field(default_factory=list)  # since when, of the arbiter
    stops: list[StopEvent] = field(default_factory=list)
    requests: list[tuple[float, ServedRequest]] = field(default_factory=list)  # time [s]
    contacts: ContactLog = field(default_factory=ContactLog)
    statistics: dict[str, TopicStatistics] = field(default_factory=dict)
    force_max_N: float = 0.0
    torque_max_Nm: float = 0.0
    unreadable: int = 0


def report_content(read: "RecordedFile", cell: "CellConfig") -> ReportContent:
    """Read a recording twice: once for its length, once for its content."""
    times = [raw.at_ns for raw in read.raw_messages()]
    if not times:
        raise DataError(f"{read.path}: the recording contains no message")
    content = ReportContent(times[0], (times[-1] - times[0]) / NS_PER_S)
    readout, next_s = Readout(cell), 0.0
    for at_s, key, snapshot in _snapshots(read, content):
        if key == topics.ARBITER_STATUS.key:
            _note_state(content, at_s, snapshot.arbiter.message)
        elif key == topics.WRENCH.key:
            if (wrench := snapshot.wrench.fresh) is not None:
                content.force_max_N = max(content.force_max_N, math.hypot(*wrench.force_N))
                content.torque_max_Nm = max(content.torque_max_Nm, math.hypot(*wrench.torque_Nm))
        elif key == topics.ROBOT_STATE.key and at_s >= next_s:
            next_s = at_s + content.duration_s / REPORT_POINTS
            _add_point(content, at_s, readout.numbers(snapshot))
    return content


def sampled_snapshots(
    read: "RecordedFile", begin_ns: int, rate_hz: float
) -> Iterator[tuple[float, Any]]:
    """Yield time [s] and the newest messages at that time, at most at a rate."""
    next_s = 0.0
    for at_s, key, snapshot in _snapshots(read, ReportContent(begin_ns, 0.0)):
        if key == topics.ROBOT_STATE.key and at_s >= next_s:
            next_s = at_s + 1.0 / rate_hz
            yield at_s, snapshot


def _snapshots(
    read: "RecordedFile", content: ReportContent
) -> Iterator[tuple[float, str, Snapshot]]:
    """Yield after each message its time [s], its topic, and the newest message of every topic."""
    snapshot = Snapshot()
    for raw in read.raw_messages():
        try:
            header, message = decode_recorded(raw.data, TYPES[raw.topic], raw.topic)
        except (MessageError, KeyError):
            content.unreadable += 1
            continue
        content.statistics.setdefault(raw.topic, TopicStatistics()).add(header, raw.at_ns)
        at_s = (raw.at_ns - content.begin_ns) / NS_PER_S
        if isinstance(message, ServedRequest):
            content.requests.append((at_s, message))
        elif isinstance(message, ContactEvent):
            content.contacts.add(at_s, header, message)
        if raw.topic in PLACES:
            reading = Reading(message, header, 0.0, "" if message.valid else message.reason or "-")
            changes: Any = {PLACES[raw.topic]: reading}
            snapshot = replace(snapshot, **changes)
            yield at_s, raw.topic, snapshot


def _note_state(content: ReportContent, at_s: float, status: Message | None) -> None:
    if not isinstance(status, ArbiterStatus):
        return
    before = content.states[-1][1] if content.states else ""
    if status.state == before:
        return
    content.states.append((at_s, status.state))
    if status.state in STOPPED and before not in STOPPED:
        content.stops += [StopEvent(at_s, status.state, trip) for trip in status.trips]


def _add_point(content: ReportContent, at_s: float, numbers: dict[str, float]) -> None:
    for name in (*content.series, *numbers):
        column = content.series.setdefault(name, [math.nan] * len(content.times_s))
        if len(column) == len(content.times_s):
            column.append(numbers.get(name, math.nan))
    content.times_s.append(at_s)
