"""Recording: frames in, a sequence of complete MCAP files out."""

import json
from pathlib import Path
from typing import Any

from common.config.cell import CellConfig
from common.config.cell_helpers import PanelSection
from common.config.load import cell_hash, dump_cell
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.errors import MessageError
from forcemesh.topics import TOPICS
from forcemesh.version import __version__
from services.recorder.folder import new_file
from services.recorder.frames import ENCODING, HEAD, NAME, Frame, descriptor, wrap
from services.recorder.layout import Layout, layout_of, schema_of
from services.recorder.mcap_writer import McapWriter
from services.recorder.stamps import SequenceGaps, WallClock

FRAMES_TOPIC = "frames"
METADATA = "forcemesh"
EVENT = "event"
CELL_FILE = "cell.yaml"
MB = 1_000_000
FLUSH_NS = NS_PER_S // 2  # half of the data that a kill may lose
CHUNK_B = 8_000_000  # limit of a chunk, reached when the pre-trigger memory is written
SEQUENCE = 2**32

FRAMES_SCHEMA = (NAME, ENCODING, descriptor())
SCHEMAS = [
    (topic.message.__name__, "jsonschema", json.dumps(schema_of(topic)).encode())
    for topic in TOPICS
]
LAYOUTS = [layout_of(topic) for topic in TOPICS]
HEADER = Layout(Header)
PLACES = {str(place): topic.key for place, topic in enumerate(TOPICS)}


class RecordingFile:
    """One MCAP file: a JSON channel for each topic, and one channel of frames."""

    def __init__(self, path: Path, cell: CellConfig, about: dict[str, str], *, at_ns: int) -> None:
        """Write metadata, cell file and channels. Raises OSError if that fails."""
        self.path = path
        self._stream = path.open("xb")
        self._frames: list[bytes] = []
        self._last_ns = 0
        writer = self._writer = McapWriter(self._stream, f"forcemesh {about['version']}")
        writer.add_metadata(METADATA, about)
        # Access data of the panel are not recorded.
        stored = cell.model_copy(update={"panel": PanelSection()})
        writer.add_attachment(CELL_FILE, "application/yaml", dump_cell(stored).encode(), at_ns)
        self._channels = [
            writer.add_channel(topic.key, "json", schema)
            for topic, schema in zip(TOPICS, SCHEMAS, strict=True)
        ]
        self._frames_channel = writer.add_channel(FRAMES_TOPIC, ENCODING, FRAMES_SCHEMA, **PLACES)
        writer.flush()

    @property
    def size_B(self) -> int:
        """Return the size of the file."""
        return self._writer.bytes

    @property
    def waiting_B(self) -> int:
        """Return the size of unflushed data before compression."""
        return self._writer.waiting_B

    def add(self, topic: int, log_ns: int, data: bytes) -> None:
        """Add a message as a frame, byte for byte."""
        self._frames += (HEAD.pack(topic, log_ns, len(data)), data)
        self._last_ns = log_ns

    def add_json(self, topic: int, log_ns: int, text: bytes, sequence: int) -> None:
        """Add the same message as JSON."""
        self._writer.add(self._channels[topic], log_ns, text, sequence)

    def note(self, what: str, at_ns: int) -> None:
        """Write an event."""
        self._writer.add_metadata(EVENT, {"at_ns": str(at_ns), "what": what})

    def flush(self) -> None:
        """Write all data so far to the file."""
        if self._frames:
            frames = wrap(b"".join(self._frames))
            self._writer.add(self._frames_channel, self._last_ns, frames, 0)
            self._frames = []
        self._writer.flush()

    def close(self) -> None:
        """Finish the file."""
        try:
            self.flush()
            self._writer.finish()
        finally:
            self._stream.close()


class Recording:
    """Recording from start to stop, split into files by duration and size."""

    def __init__(
        self,
        folder: Path,
        name: str,
        cell: CellConfig,
        *,
        cause: str,
        wall_clock: WallClock,
        now_ns: int,
    ) -> None:
        """Open the first file. Raises OSError if the folder cannot be written."""
        self.messages = 0
        self.unshaped = 0  # of them: kept byte for byte, but not decodable
        self.numbering = SequenceGaps()
        self.cause, self.since_ns = cause, now_ns
        self._folder, self._name, self._cell, self._wall_clock = folder, name, cell, wall_clock
        self._opened_ns = self._flushed_ns = now_ns
        self._file = self._next_file(now_ns)

    @property
    def path(self) -> Path:
        """Return the present or last file."""
        return self._file.path

    @property
    def file_bytes(self) -> int:
        """Return the size of the file."""
        return self._file.size_B

    def write(self, frames: list[Frame], now_ns: int) -> None:
        """Write frames; flush when due. Raises OSError if that fails."""
        write = self._write
        for topic, at_ns, data in frames:
            write(topic, at_ns, data)
        if now_ns - self._flushed_ns < FLUSH_NS and self._file.waiting_B < CHUNK_B:
            return
        self._file.flush()
        self._flushed_ns = now_ns
        section = self._cell.recorder
        is_long = now_ns - self._opened_ns >= section.file_min * 60 * NS_PER_S
        if is_long or self._file.size_B >= section.file_MB * MB:
            self._file.close()
            self._opened_ns = now_ns
            self._file = self._next_file(now_ns)

    def note(self, what: str, at_ns: int) -> None:
        """Write an event at a monotonic time."""
        self._file.note(what, self._wall_clock.arrival_ns(at_ns))

    def close(self) -> None:
        """Finish the present file."""
        self._file.close()

    def _write(self, topic: int, at_ns: int, data: bytes) -> None:
        """Write a message twice: byte for byte, and as readable JSON."""
        self.messages += 1
        layout = LAYOUTS[topic]
        try:
            message = layout.read(data)
        except MessageError:
            self._write_unshaped(topic, at_ns, data)
            return
        log_ns = self._stamped_ns(topic, message, at_ns)
        self._file.add(topic, log_ns, data)
        self._file.add_json(topic, log_ns, layout.text(message), message.seq % SEQUENCE)

    def _write_unshaped(self, topic: int, at_ns: int, data: bytes) -> None:
        """Write an undecodable message byte for byte; its header may still be valid."""
        self.unshaped += 1
        try:
            log_ns = self._stamped_ns(topic, HEADER.read(data), at_ns)
        except MessageError:
            log_ns = self._wall_clock.arrival_ns(at_ns)
        self._file.add(topic, log_ns, data)

    def _stamped_ns(self, topic: int, head: Any, at_ns: int) -> int:
        """Count sequence gaps; return the wall clock time of publication [ns]."""
        self.numbering.saw(topic, head.epoch, head.seq)
        return self._wall_clock.written_ns(head.boot, head.stamp_ns, at_ns)

    def _next_file(self, now_ns: int) -> RecordingFile:
        about = {
            "cell": self._cell.cell,
            "version": __version__,
            "config_hash": cell_hash(self._cell),
            "cause": self.cause,
            "clock": self._wall_clock.boot,
            "wall_minus_monotonic_ns": str(self._wall_clock.offsets_ns[self._wall_clock.boot]),
        }
        path = new_file(self._folder, self._name)
        return RecordingFile(path, self._cell, about, at_ns=self._wall_clock.arrival_ns(now_ns))
