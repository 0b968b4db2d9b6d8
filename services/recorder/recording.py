"""Recording: frames in, a sequence of complete MCAP files out."""

import json
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from mcap.writer import Writer

from common.config.cell import CellConfig
from common.config.cell_helpers import PanelSection
from common.config.load import cell_hash, dump_cell
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.errors import MessageError
from forcemesh.topics import TOPICS
from forcemesh.version import __version__
from services.recorder.folder import file_name, folder_of, new_file
from services.recorder.frames import (
    CELL_FILE,
    EVENT,
    FRAMES_SCHEMA,
    FRAMES_TOPIC,
    METADATA,
    Frame,
    pack_frames,
    wrap,
)
from services.recorder.layout import Layout, layout_of, schema_of
from services.recorder.ring_buffer import Block
from services.recorder.stamps import SequenceGaps, WallClock

MB = 1_000_000
FLUSH_NS = NS_PER_S // 2  # half of the data that a kill may lose
CHUNK_B = 8_000_000  # limit of a chunk, reached when the pre-trigger memory is written
SEQUENCE = 2**32

SCHEMAS = [json.dumps(schema_of(topic)).encode() for topic in TOPICS]
LAYOUTS = [layout_of(topic) for topic in TOPICS]
HEADER = Layout(Header)
PLACES = {str(place): topic.key for place, topic in enumerate(TOPICS)}


class Recording:
    """Recording from start to stop, split into files by duration and size.

    A file has a JSON channel for each topic, and one channel of frames.
    """

    def __init__(
        self,
        cell: CellConfig,
        wall_clock: WallClock,
        now_ns: int,
        *,
        cause: str,
        past: Iterable[Block] = (),
        label: str = "",
        number: int = 0,
    ) -> None:
        """Open the first file. Raises OSError if the folder cannot be written.

        Args:
            cell: The recorded cell, with the folder.
            wall_clock: Wall clock of the whole recording.
            now_ns: Monotonic time.
            cause: Code of the stop, or that it was asked for.
            past: Blocks of the ring buffer that it begins with.
            label: Last part of the name.
            number: Number among the recordings of the stop's code.
        """
        self.waiting: deque[Iterable[Frame]] = deque(block.frames() for block in past)
        self.messages = 0
        self.unshaped = 0  # of them: kept byte for byte, but not decodable
        self.gaps = SequenceGaps()
        self.cause, self.since_ns, self._number = cause, now_ns, number
        self._cell, self._wall_clock = cell, wall_clock
        self._name = file_name(cell.cell, wall_clock.arrival_ns(now_ns), label)
        self._open_file(now_ns)

    def write(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Write each message twice, as readable JSON and byte for byte; flush when due.

        Raises OSError if the disk fails.
        """
        kept: list[Frame] = []
        log_ns = 0
        for topic, at_ns, data in frames:
            try:
                header = message = LAYOUTS[topic].read(data)
            except MessageError:
                header, message = self._header(data), None
            if header is None:
                log_ns = self._wall_clock.arrival_ns(at_ns)
            else:
                self.gaps.saw(topic, header.epoch, header.seq)
                log_ns = self._wall_clock.written_ns(header.boot, header.stamp_ns, at_ns)
            kept.append(Frame(topic, log_ns, data))
            if message is not None:
                text, sequence = LAYOUTS[topic].text(message), message.seq % SEQUENCE
                self._writer.add_message(self._channels[topic], log_ns, text, log_ns, sequence)
        if kept:
            self.messages += len(kept)
            self._writer.add_message(self._frames, log_ns, wrap(pack_frames(kept)), log_ns)
        if now_ns - self._flushed_ns >= FLUSH_NS:
            self._flush(now_ns)

    def note(self, what: str, at_ns: int) -> None:
        """Write an event at a monotonic time."""
        wall_ns = self._wall_clock.arrival_ns(at_ns)
        self._writer.add_metadata(EVENT, {"at_ns": str(wall_ns), "what": what})

    def close(self) -> None:
        """Finish the present file."""
        with self._stream:
            self._writer.finish()
            self.file_bytes = self._stream.tell()

    def abandon(self) -> None:
        """Close the present file as it is: it can be read up to the write that failed."""
        with suppress(OSError):
            self._stream.close()

    def _header(self, data: bytes) -> Any:
        """Count an undecodable message; return its header, None if that is undecodable too."""
        self.unshaped += 1
        with suppress(MessageError):
            return HEADER.read(data)
        return None

    def _flush(self, now_ns: int) -> None:
        """Write all data so far to the file; begin the next one at its limits."""
        self._writer.flush()
        self._flushed_ns, self.file_bytes = now_ns, self._stream.tell()
        section = self._cell.recorder
        is_long = now_ns - self._opened_ns >= section.file_min * 60 * NS_PER_S
        if is_long or self.file_bytes >= section.file_MB * MB:
            self.close()
            self._open_file(now_ns)

    def _open_file(self, now_ns: int) -> None:
        """Open the next file; write metadata, cell file and channels."""
        self.path = new_file(folder_of(self._cell), self._name)
        self._stream = self.path.open("xb")
        self.file_bytes = 0
        self._opened_ns: int = now_ns
        self._flushed_ns = now_ns
        self._writer: Writer = Writer(self._stream, CHUNK_B)
        writer = self._writer
        writer.start(library=f"forcemesh {__version__}")
        about = {
            "cell": self._cell.cell,
            "version": __version__,
            "config_hash": cell_hash(self._cell),
            "cause": self.cause,
            "number": str(self._number),
            "clock": self._wall_clock.boot,
            "wall_minus_monotonic_ns": str(self._wall_clock.arrival_ns(0)),
        }
        writer.add_metadata(METADATA, about)
        # Access data of the panel are not recorded.
        stored = dump_cell(self._cell.model_copy(update={"panel": PanelSection()})).encode()
        at_ns = self._wall_clock.arrival_ns(now_ns)
        writer.add_attachment(at_ns, at_ns, CELL_FILE, "application/yaml", stored)
        self._channels = []
        for topic, schema in zip(TOPICS, SCHEMAS, strict=True):
            schema_id = writer.register_schema(topic.message.__name__, "jsonschema", schema)
            self._channels.append(writer.register_channel(topic.key, "json", schema_id))
        schema_id = writer.register_schema(**FRAMES_SCHEMA)
        self._frames = writer.register_channel(FRAMES_TOPIC, "protobuf", schema_id, PLACES)
        writer.flush()
