"""Reader of recordings, complete or truncated by a killed recorder, and their playback on a bus.

Played bytes are the same except for the address, if the cell has another name now or the recording
is of an older schema version.
"""

import heapq
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import zstandard
from mcap import records
from mcap.exceptions import McapError
from mcap.stream_reader import StreamReader, breakup_chunk
from pydantic_core import from_json

from common.config.calibration import NO_FILE
from common.config.cell import CellConfig
from common.config.load import CALIBRATION, cell_from_tree
from forcemesh.bus import Transport
from forcemesh.clock import NS_PER_S, Clock
from forcemesh.errors import ConfigError, DataError
from forcemesh.recorded_messages import readdressed
from forcemesh.topics import TOPICS
from forcemesh.yaml_file import parse_yaml
from services.recorder.frames import (
    CELL_FILE,
    EVENT,
    FRAMES_TOPIC,
    METADATA,
    Frame,
    frames_of,
    unwrap,
)

BROKEN_OFF = (McapError, struct.error, zstandard.ZstdError, ValueError, OverflowError, MemoryError)
GRAVITY = "gravity_direction_in_base"
DISORDER_NS = 3 * NS_PER_S  # largest offset of a message in a file from its order in time
MOST_CHUNK_B = 1 << 28  # of other robots too; the recorder writes 8 MB
QOS = {topic.key: topic.qos for topic in TOPICS}


class Event(NamedTuple):
    """Event of a recording."""

    at_ns: int
    code: str  # a code of forcemesh/faults.py


class RecordedMessage(NamedTuple):
    """One message as readable JSON: vectors are maps, None is omitted."""

    topic: str
    at_ns: int  # wall clock time
    fields: dict[str, Any]


class RecordedBytes(NamedTuple):
    """One message byte for byte."""

    topic: str
    at_ns: int  # wall clock time
    data: bytes


class RecordedFile:
    """One file. Its metadata are read on opening."""

    def __init__(self, path: Path) -> None:
        """Read the metadata. Raises DataError if it is not a forcemesh recording."""
        self.path = path
        self.about: dict[str, str] = {}
        self.is_whole = False  # known after the first pass
        self.events: list[Event] = []
        self._cell_file: bytes | None = None
        self._channels: dict[int, records.Channel] = {}
        for record in self._records(whole_chunks=True):
            if isinstance(record, records.Chunk):
                break
        if not self.about:
            raise DataError(f"{path}: not a forcemesh recording, or truncated: it has no metadata")

    @cached_property
    def cell(self) -> CellConfig | None:
        """Return the recorded cell; None if another version wrote it: its messages can be read."""
        if self._cell_file is None:
            return None
        try:
            text = self._cell_file.decode()
            tree = parse_yaml(text, str(self.path))
            _take_older_keys(tree)
            return cell_from_tree(tree, str(self.path))
        except (ConfigError, UnicodeDecodeError):
            return None

    def messages(self, topic: str | None = None) -> Iterator[RecordedMessage]:
        """Yield every message, or those of one topic, in the order of the file.

        Within a topic that is the order of publication; between topics approximately.
        """
        for channel, message in self._message_records():
            key = channel.topic
            if channel.message_encoding == "json" and topic in (None, key):
                yield RecordedMessage(key, message.log_time, from_json(message.data))

    def raw_messages(self) -> Iterator[RecordedBytes]:
        """Yield every message byte for byte, in the order of time.

        Raises DataError if the frames are of an unknown format.
        """
        waiting: list[tuple[int, int, RecordedBytes]] = []
        number = 0
        for channel, message in self._message_records():
            if channel.topic != FRAMES_TOPIC:
                continue
            for frame in self._frames(message.data):
                topic = channel.metadata[str(frame.topic)]
                heapq.heappush(waiting, (frame.at_ns, number, RecordedBytes(topic, *frame[1:])))
                number += 1
            while waiting and waiting[0][0] < message.log_time - DISORDER_NS:
                yield heapq.heappop(waiting)[2]
        while waiting:
            yield heapq.heappop(waiting)[2]

    def _frames(self, data: bytes) -> list[Frame]:
        try:
            return list(frames_of(unwrap(data)))
        except ValueError as error:
            text = f"{self.path}: {error}: written by another version; its JSON can still be read"
            raise DataError(text) from error

    def _message_records(self) -> Iterator[tuple[records.Channel, records.Message]]:
        for record in self._records():
            if isinstance(record, records.Message) and record.channel_id in self._channels:
                yield self._channels[record.channel_id], record

    def _records(self, *, whole_chunks: bool = False) -> Iterator[records.McapRecord]:
        self.events, self.is_whole = [], False
        for record in records_of(self.path, whole_chunks=whole_chunks):
            self._note(record)
            yield record

    def _note(self, record: records.McapRecord) -> None:
        if isinstance(record, records.Channel):
            self._channels[record.id] = record
        elif isinstance(record, records.Metadata) and record.name == METADATA:
            self.about = record.metadata
        elif isinstance(record, records.Metadata) and record.name == EVENT:
            with suppress(KeyError, ValueError):  # another program's metadata of this name
                self.events.append(Event(int(record.metadata["at_ns"]), record.metadata["what"]))
        elif isinstance(record, records.Attachment) and record.name == CELL_FILE:
            self._cell_file = record.data
        elif isinstance(record, records.DataEnd):
            self.is_whole = True


def _take_older_keys(tree: Any) -> None:
    """Change a recorded cell in which gravity is a key of the payload, as all once were.

    A cell without a calibration file then worked with the payload of its cell file.
    """
    payload = tree.get("payload") if isinstance(tree, dict) else None
    if isinstance(payload, dict) and (gravity := payload.pop(GRAVITY, None)) is not None:
        tree.setdefault(GRAVITY, gravity)
        if tree.get(CALIBRATION) is None:
            tree[CALIBRATION] = NO_FILE


def records_of(path: Path, *, whole_chunks: bool = False) -> Iterator[records.McapRecord]:
    """Yield the records of a file, those in chunks as well, up to its end or its truncation.

    Args:
        path: An MCAP file of any program.
        whole_chunks: Chunks themselves, not the records in them.

    Raises:
        DataError: The file cannot be opened, or a chunk declares more than any recording has.
    """
    try:
        stream = path.open("rb")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    with stream, suppress(*BROKEN_OFF):
        reader = StreamReader(stream, emit_chunks=True, record_size_limit=MOST_CHUNK_B)
        for record in reader.records:
            if isinstance(record, records.Chunk):
                _refuse_large(path, record)
                if not whole_chunks:
                    yield from breakup_chunk(record)
                    continue
            yield record
            if isinstance(record, records.DataEnd):
                return


def _refuse_large(path: Path, chunk: records.Chunk) -> None:
    """Raise DataError for a chunk that declares more data than any recording has in one.

    The decompressor reserves the size that a zstd frame declares before it reads the data.
    """
    declared_B = chunk.uncompressed_size
    if chunk.compression == "zstd":
        with suppress(zstandard.ZstdError):  # a broken frame reserves nothing
            declared_B = max(declared_B, zstandard.frame_content_size(chunk.data))
    if declared_B > MOST_CHUNK_B:
        raise DataError(
            f"{path}: a chunk declares {declared_B / 1e6:.0f} MB, the limit is "
            f"{MOST_CHUNK_B / 1e6:.0f} MB: damaged, or no recording; `mcap compress --chunk-size` "
            "writes smaller ones"
        )


def play(
    messages: Iterable[RecordedBytes],
    transport: Transport,
    cell: str,
    *,
    clock: Clock,
    speed: float = 1.0,
    shown: Callable[[int, float], None] = lambda _count, _at_s: None,
) -> int:
    """Publish messages on the bus of a cell at their times; return how many.

    Args:
        messages: The messages in the order of time.
        transport: Transport to publish on.
        cell: Name of the cell, prefix of the keys.
        clock: Clock of the playback.
        speed: Factor on the original speed; infinite: as fast as possible.
        shown: Called after each message with their number and the recorded time [s].
    """
    puts: dict[str, Callable[[bytes], None]] = {}
    began_ns, first_ns, count = clock.now_ns(), 0, 0
    for count, each in enumerate(messages, start=1):
        first_ns = first_ns or each.at_ns
        due_ns = began_ns + round((each.at_ns - first_ns) / speed)
        if (early_ns := due_ns - clock.now_ns()) > 0:
            clock.sleep_s(early_ns / NS_PER_S)
        if each.topic not in puts:
            puts[each.topic] = transport.publish(
                f"{cell}/{each.topic}", QOS.get(each.topic, "report")
            )
        puts[each.topic](readdressed(each.data, f"{cell}/{each.topic}"))
        shown(count, (each.at_ns - first_ns) / NS_PER_S)
    return count
