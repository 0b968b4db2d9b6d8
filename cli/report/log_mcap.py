"""Force logs as tables: one topic of an MCAP file of any program.

Read are messages in JSON, with nested fields joined by dots, and ROS 2's geometry_msgs/Wrench and
WrenchStamped in CDR. Everything else is refused with its schema and encoding.
"""

import json
import struct
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, DataEnd, McapRecord, Message, Schema

from cli.recording_tables import flat_fields
from forcemesh.clock import NS_PER_S
from forcemesh.errors import DataError
from services.recorder.reading import records_of

MAGIC = b"\x89MCAP0\r\n"
LOG_TIME, STAMP = "log_time_s", "stamp_s"
STAMP_FIELDS = (  # seconds and nanoseconds of a header, in ROS 2 and in Foxglove's JSON
    ("header.stamp.sec", "header.stamp.nanosec"),
    ("header.stamp.sec", "header.stamp.nsec"),
    ("timestamp.sec", "timestamp.nsec"),
)
CDR_HEAD_B = 4  # encapsulation; its second byte is 1 in little-endian order
PARTS = ("force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z")
CONVERT = (
    "read are JSON and geometry_msgs/WrenchStamped of ROS 2 (cdr); export the topic as CSV, for "
    "example with PlotJuggler"
)
TRUNCATED = "the file is truncated: read up to its end"
Fields = dict[str, Any]


class _Content(NamedTuple):
    """One message: its time in the file, and its fields."""

    log_ns: int
    fields: Fields


class McapTable:
    """Messages of one topic of an MCAP file."""

    row_word = "message"

    def __init__(self, path: Path, topic: str | None) -> None:
        """Read the names of the fields. Raises DataError if no topic, or several, can be read."""
        self.path = path
        self.notes: list[str] = []
        self._channels = self._listed()
        self.topic = topic or self._only_topic()
        self._decode = self._decoder()
        names = {name: None for content in self._contents() for name in content.fields}
        if not names:
            raise DataError(f"{path}: topic {self.topic} has no message with fields")
        self._stamp = next((pair for pair in STAMP_FIELDS if names.keys() >= set(pair)), None)
        self.time_names: tuple[str, ...] = (STAMP, LOG_TIME) if self._stamp else (LOG_TIME,)
        self.names = (*self.time_names, *names)

    def rows(self, chosen: Sequence[str]) -> Iterator[tuple[int, list[object]]]:
        """Yield number and cells of each message, in the order of the file's times."""
        found = [
            (content.log_ns, number, [self._cell(content, name) for name in chosen])
            for number, content in enumerate(self._contents(), 1)
        ]
        for _, number, cells in sorted(found, key=itemgetter(0)):
            yield number, cells

    def _cell(self, content: _Content, name: str) -> object:
        if name == LOG_TIME:
            return content.log_ns / NS_PER_S
        if name == STAMP and self._stamp is not None:
            seconds, nanoseconds = (content.fields.get(part, 0) for part in self._stamp)
            return seconds + nanoseconds / NS_PER_S
        return content.fields.get(name)

    def _listed(self) -> dict[str, tuple[Schema | None, Channel]]:
        found: dict[str, tuple[Schema | None, Channel]] = {}
        for schema, channel, _ in self._messages(None):
            found.setdefault(channel.topic, (schema, channel))
        if not found:
            raise DataError(f"{self.path}: not a recording, or truncated: it has no message")
        return found

    def _only_topic(self) -> str:
        readable = [name for name, kind in self._channels.items() if _decoder_of(*kind)]
        if len(readable) == 1:
            if len(self._channels) > 1:
                self.notes.append(f"the topic is {readable[0]}, the only one that can be read")
            return readable[0]
        raise DataError(
            f"{self.path}: name one topic with --topic; the topics are: {self._topics_text()}"
        )

    def _topics_text(self) -> str:
        return ", ".join(f"{name} ({_kind(*kind)})" for name, kind in self._channels.items())

    def _decoder(self) -> Callable[[bytes], Fields]:
        if self.topic not in self._channels:
            raise DataError(
                f"{self.path}: topic {self.topic!r} is missing; the topics are: "
                f"{self._topics_text()}"
            )
        kind = self._channels[self.topic]
        if (decode := _decoder_of(*kind)) is None:
            raise DataError(
                f"{self.path}: topic {self.topic} is {_kind(*kind)} and cannot be read: {CONVERT}"
            )
        return decode

    def _contents(self) -> Iterator[_Content]:
        for number, (_, _, message) in enumerate(self._messages(self.topic), 1):
            try:
                yield _Content(message.log_time, self._decode(message.data))
            except (ValueError, struct.error) as error:
                raise DataError(
                    f"{self.path}: topic {self.topic}, message {number} cannot be decoded: {error}"
                ) from None

    def _messages(self, topic: str | None) -> Iterator[tuple[Schema | None, Channel, Message]]:
        """Yield schema, channel and message up to the end of the file, or to its truncation."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        record: McapRecord | None = None
        for record in records_of(self.path):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message) and record.channel_id in channels:
                channel = channels[record.channel_id]
                if topic in (None, channel.topic):
                    yield schemas.get(channel.schema_id), channel, record
        if not isinstance(record, DataEnd) and TRUNCATED not in self.notes:
            self.notes.append(TRUNCATED)


def is_mcap(path: Path) -> bool:
    """Return whether a file begins as MCAP files do. Raises DataError if it cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None


def _kind(schema: Schema | None, channel: Channel) -> str:
    name = schema.name if schema is not None else "no schema"
    return f"{name}, {channel.message_encoding or 'no encoding'}"


def _decoder_of(schema: Schema | None, channel: Channel) -> Callable[[bytes], Fields] | None:
    if channel.message_encoding == "json":
        return _from_json
    name = schema.name.replace("/msg/", "/") if schema is not None else ""
    if channel.message_encoding == "cdr" and name == "geometry_msgs/WrenchStamped":
        return _from_stamped_cdr
    if channel.message_encoding == "cdr" and name == "geometry_msgs/Wrench":
        return _from_cdr
    return None


def _from_json(data: bytes) -> Fields:
    return dict(flat_fields(json.loads(data)))


def _from_cdr(data: bytes) -> Fields:
    """Return the fields of a Wrench: six doubles (OMG CDR, DDSI-RTPS 10.2)."""
    return dict(zip(PARTS, struct.unpack_from(f"{_order(data)}6d", data, CDR_HEAD_B), strict=True))


def _from_stamped_cdr(data: bytes) -> Fields:
    """Return the fields of a WrenchStamped: time stamp, name of the frame, six doubles.

    A double is aligned to 8 bytes, counted from the end of the encapsulation.
    """
    order = _order(data)
    second, nanosecond, length = struct.unpack_from(f"{order}iII", data, CDR_HEAD_B)
    at = 12 + length
    at += -at % 8
    numbers = struct.unpack_from(f"{order}6d", data, CDR_HEAD_B + at)
    stamp = dict(zip(STAMP_FIELDS[0], (second, nanosecond), strict=True))
    return stamp | {f"wrench.{name}": value for name, value in zip(PARTS, numbers, strict=True)}


def _order(data: bytes) -> str:
    if len(data) < CDR_HEAD_B:
        raise ValueError("it is shorter than its encapsulation")
    return "<" if data[1] & 1 else ">"
