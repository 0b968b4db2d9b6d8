"""Recording: frames in, a sequence of complete MCAP files out, over a write queue.

A disk error ends the recording and does not interrupt reception.
"""

import json
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from common.config.cell import CellConfig
from common.config.cell_helpers import PanelSection
from common.config.load import cell_hash, dump_cell
from forcemesh.clock import NS_PER_S, Clock
from forcemesh.codec import Header
from forcemesh.errors import MessageError
from forcemesh.faults import clipped
from forcemesh.topics import TOPICS
from forcemesh.version import __version__
from services.recorder.folder import file_name, folder_of, free_bytes, new_file
from services.recorder.frames import DESCRIPTOR, ENCODING, HEAD, NAME, Frame, wrap
from services.recorder.layout import Layout, layout_of, schema_of
from services.recorder.mcap_writer import McapWriter
from services.recorder.ring_buffer import Block
from services.recorder.stamps import SequenceGaps, WallClock

FRAMES_TOPIC = "frames"
METADATA = "forcemesh"
EVENT = "event"
CELL_FILE = "cell.yaml"
MB, GB = 1_000_000, 1_000_000_000
SPACE_CHECK_NS = NS_PER_S  # period of the check of free space
FLUSH_NS = NS_PER_S // 2  # half of the data that a kill may lose
CHUNK_B = 8_000_000  # limit of a chunk, reached when the pre-trigger memory is written
SEQUENCE = 2**32

FRAMES_SCHEMA = (NAME, ENCODING, DESCRIPTOR)
SCHEMAS = [
    (topic.message.__name__, "jsonschema", json.dumps(schema_of(topic)).encode())
    for topic in TOPICS
]
LAYOUTS = [layout_of(topic) for topic in TOPICS]
HEADER = Layout(Header)
PLACES = {str(place): topic.key for place, topic in enumerate(TOPICS)}


class Recording:
    """Recording from start to stop, split into files by duration and size.

    A file has a JSON channel for each topic, and one channel of frames.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        cell: CellConfig,
        *,
        cause: str,
        wall_clock: WallClock,
        now_ns: int,
        number: int = 0,
    ) -> None:
        """Open the first file. Raises OSError if the folder cannot be written.

        `number` counts the recordings of a stop's code.
        """
        self.messages = 0
        self.unshaped = 0  # of them: kept byte for byte, but not decodable
        self.numbering = SequenceGaps()
        self.cause, self.since_ns, self._number = cause, now_ns, number
        self._folder, self._name, self._cell, self._wall_clock = folder, name, cell, wall_clock
        self._frames: list[bytes] = []  # since the last flush
        self._last_ns = 0  # time of the last frame
        self._flushed_ns = now_ns
        self._open_file(now_ns)

    @property
    def file_bytes(self) -> int:
        """Return the size of the present or last file."""
        return self._writer.bytes

    def write(self, frames: list[Frame], now_ns: int) -> None:
        """Write frames; flush when due. Raises OSError if that fails."""
        write = self._write
        for topic, at_ns, data in frames:
            write(topic, at_ns, data)
        if now_ns - self._flushed_ns < FLUSH_NS and self._writer.waiting_B < CHUNK_B:
            return
        self._flush()
        self._flushed_ns = now_ns
        section = self._cell.recorder
        is_long = now_ns - self._opened_ns >= section.file_min * 60 * NS_PER_S
        if is_long or self._writer.bytes >= section.file_MB * MB:
            self.close()
            self._open_file(now_ns)

    def note(self, what: str, at_ns: int) -> None:
        """Write an event at a monotonic time."""
        wall_ns = self._wall_clock.arrival_ns(at_ns)
        self._writer.add_metadata(EVENT, {"at_ns": str(wall_ns), "what": what})

    def close(self) -> None:
        """Finish the present file."""
        try:
            self._flush()
            self._writer.finish()
        finally:
            self._stream.close()

    def _write(self, topic: int, at_ns: int, data: bytes) -> None:
        """Write a message twice: byte for byte, and as readable JSON."""
        self.messages += 1
        layout = LAYOUTS[topic]
        try:
            message = layout.read(data)
        except MessageError:
            self.unshaped += 1
            self._add_frame(topic, self._unshaped_ns(topic, at_ns, data), data)
            return
        log_ns = self._stamped_ns(topic, message, at_ns)
        self._add_frame(topic, log_ns, data)
        sequence = message.seq % SEQUENCE
        self._writer.add(self._channels[topic], log_ns, layout.text(message), sequence)

    def _add_frame(self, topic: int, log_ns: int, data: bytes) -> None:
        self._frames += (HEAD.pack(topic, log_ns, len(data)), data)
        self._last_ns = log_ns

    def _unshaped_ns(self, topic: int, at_ns: int, data: bytes) -> int:
        """Return the time of an undecodable message [ns]; its header may still be valid."""
        try:
            return self._stamped_ns(topic, HEADER.read(data), at_ns)
        except MessageError:
            return self._wall_clock.arrival_ns(at_ns)

    def _stamped_ns(self, topic: int, head: Any, at_ns: int) -> int:
        """Count sequence gaps; return the wall clock time of publication [ns]."""
        self.numbering.saw(topic, head.epoch, head.seq)
        return self._wall_clock.written_ns(head.boot, head.stamp_ns, at_ns)

    def _flush(self) -> None:
        """Write all data so far to the file."""
        if self._frames:
            frames = wrap(b"".join(self._frames))
            self._writer.add(self._frames_channel, self._last_ns, frames, 0)
            self._frames = []
        self._writer.flush()

    def _open_file(self, now_ns: int) -> None:
        """Open the next file; write metadata, cell file and channels."""
        path = new_file(self._folder, self._name)
        self._stream = path.open("xb")
        self.path, self._opened_ns = path, now_ns
        writer = self._writer = McapWriter(self._stream, f"forcemesh {__version__}")
        about = {
            "cell": self._cell.cell,
            "version": __version__,
            "config_hash": cell_hash(self._cell),
            "cause": self.cause,
            "number": str(self._number),
            "clock": self._wall_clock.boot,
            "wall_minus_monotonic_ns": str(self._wall_clock.offsets_ns[self._wall_clock.boot]),
        }
        writer.add_metadata(METADATA, about)
        # Access data of the panel are not recorded.
        stored = dump_cell(self._cell.model_copy(update={"panel": PanelSection()})).encode()
        at_ns = self._wall_clock.arrival_ns(now_ns)
        writer.add_attachment(CELL_FILE, "application/yaml", stored, at_ns)
        self._channels = [
            writer.add_channel(topic.key, "json", schema)
            for topic, schema in zip(TOPICS, SCHEMAS, strict=True)
        ]
        self._frames_channel = writer.add_channel(FRAMES_TOPIC, ENCODING, FRAMES_SCHEMA, **PLACES)
        writer.flush()


class RecordingWriter:
    """Writer of at most one recording, with its write queue."""

    def __init__(self, cell: CellConfig, clock: Clock, wall_ns: Callable[[], int]) -> None:
        """Start without a recording."""
        self.recording: Recording | None = None
        self.last: Recording | None = None  # the present or the last one
        self.free_bytes = 0
        self.folder = folder_of(cell.recorder.folder)
        self._cell, self._clock, self._wall_ns = cell, clock, wall_ns
        self._waiting: deque[Block | list[Frame]] = deque()
        self._no_space, self._broken = "", ""
        self._checked_ns: int | None = None

    @property
    def fault(self) -> str:
        """Return why it cannot record, empty if it can."""
        return self._no_space or self._broken

    @property
    def waits(self) -> bool:
        """Return whether the write queue is not empty."""
        return bool(self._waiting)

    def begin(
        self, label: str, cause: str, ring_buffer: list[Block], *, number: int = 0
    ) -> Recording | None:
        """Start a recording with the pre-trigger memory; return None if it cannot be started."""
        self.check_space()
        if self._no_space:
            return None
        now_ns = self._clock.now_ns()
        wall_clock = WallClock(self._clock.boot, self._wall_ns() - now_ns)
        name = file_name(self._cell.cell, wall_clock.arrival_ns(now_ns), label)

        def open_it() -> None:
            self.recording = self.last = Recording(
                self.folder,
                name,
                self._cell,
                cause=cause,
                number=number,
                wall_clock=wall_clock,
                now_ns=now_ns,
            )
            self._broken = ""

        self._waiting = deque(ring_buffer)
        self._try(open_it)
        return self.recording

    def add(self, frames: list[Frame]) -> None:
        """Queue frames for writing, if there is a recording."""
        if self.recording is not None:
            self._waiting.append(frames)

    def note(self, what: str) -> None:
        """Write an event of now into the recording."""
        if self.recording is not None:
            self._try(self.recording.note, what, self._clock.now_ns())

    def work(self, longest_ns: int) -> None:
        """Write from the queue for a limited time."""
        give_up_ns = self._clock.now_ns() + longest_ns
        while self._waiting and self.recording is not None:
            waiting = self._waiting.popleft()
            frames = waiting.frames() if isinstance(waiting, Block) else waiting
            self._try(self.recording.write, frames, self._clock.now_ns())
            if self._clock.now_ns() >= give_up_ns:
                return

    def end(self, longest_ns: int) -> None:
        """Write the queue for a limited time, and finish the file."""
        self.work(longest_ns)
        recording, self.recording = self.recording, None
        self._waiting.clear()
        if recording is not None:
            self._try(recording.close)

    def check_space(self) -> None:
        """Check the free space once per period, and stop before it is used up."""
        now_ns = self._clock.now_ns()
        if self._checked_ns is not None and now_ns - self._checked_ns < SPACE_CHECK_NS:
            return
        self._checked_ns = now_ns
        self._try(self._measure_space)

    def _measure_space(self) -> None:
        self.free_bytes = free_bytes(self.folder)
        free_GB, least_GB = self.free_bytes / GB, self._cell.recorder.least_free_GB
        if free_GB >= least_GB:
            self._no_space = ""
            return
        stopped = "recording stopped: " if self.recording is not None else ""
        self._no_space = self._no_space or clipped(
            f"{stopped}{free_GB:.1f} GB are free at {self.folder}, "
            f"recorder.least_free_GB is {least_GB:g}"
        )
        self._drop()

    def _try(self, use: Callable[..., None], *arguments: Any) -> None:
        """Run a disk operation; an error ends the recording, and nothing else."""
        try:
            use(*arguments)
        except OSError as error:
            self._broken = clipped(f"cannot write to {self.folder}: {error.strerror or error}")
            self._drop()

    def _drop(self) -> None:
        """End the recording as far as the disk allows."""
        recording, self.recording = self.recording, None
        self._waiting.clear()
        if recording is not None:
            with suppress(OSError):
                recording.close()
