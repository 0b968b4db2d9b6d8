"""Recorder service: receives every topic, keeps the pre-trigger memory, writes on request."""

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.codec import decode
from forcemesh.errors import DataError, MessageError
from forcemesh.faults import clipped, refusal
from forcemesh.messages import ArbiterStatus, RecorderStatus
from forcemesh.requests import RecordRequest, Reply
from forcemesh.topics import TOPICS
from services.recorder.folder import SUFFIX, safe_label, stop_label
from services.recorder.frames import Frame
from services.recorder.reading import RecordedFile
from services.recorder.recording import RecordingWriter
from services.recorder.ring_buffer import RingBuffer

STEPS_HZ = 10.0
RECORDER_QUEUE = 4096  # receive queue of one topic: eight seconds of the fastest one
WORK_NS = NS_PER_S // 40  # of each step, for writing
LAST_WORK_NS = 3 * NS_PER_S // 2  # at the end: limit of the delay when a cell stops
MB = 1_000_000
STATUS_PLACE = TOPICS.index(topics.ARBITER_STATUS)
STOPPED = ("HOLDING", "FAULT")
ASKED = "asked"
LARGEST_COUNTER = 2**53  # largest integer that every language represents exactly


class StopRecording(NamedTuple):
    """One recording with all of its files. `number` counts those of a code; 0 in older files."""

    number: int
    name: str  # of its files without their own numbers
    paths: tuple[Path, ...]


class Retention:
    """Recordings of one cell's stops in a folder: the newest of each code are kept.

    Cell, code and order are read from the recordings: a file name does not separate neighbouring
    cells, and the wall clock may have been set back.
    """

    def __init__(self, folder: Path, cell: str) -> None:
        """Read nothing yet."""
        self.unreadable: set[Path] = set()  # kept
        self._folder, self._cell = folder, cell
        self._about: dict[Path, dict[str, str]] = {}

    def of_code(self, code: str) -> list[StopRecording]:
        """Return the recordings of a stop's code, the oldest first."""
        found: dict[tuple[int, str], list[Path]] = {}
        for path in sorted(self._folder.glob(f"{self._cell}-*-{stop_label(code)}-*{SUFFIX}")):
            about = self._read(path)
            if about.get("cell") == self._cell and about.get("cause") == code:
                number = about.get("number", "")
                key = int(number) if number.isdecimal() else 0, path.stem.rpartition("-")[0]
                found.setdefault(key, []).append(path)
        return [StopRecording(*key, tuple(paths)) for key, paths in sorted(found.items())]

    def remove_oldest(self, past: list[StopRecording], keep: int) -> None:
        """Remove whole recordings, listed before the open one began, down to `keep` with that one.

        A file that cannot be removed stays, and is reported.
        """
        for recording in past[: max(len(past) + 1 - keep, 0)]:
            for path in recording.paths:
                try:
                    path.unlink(missing_ok=True)
                except OSError as error:
                    sys.stderr.write(f"{path}: cannot be removed: {error.strerror}\n")
                self._about.pop(path, None)

    def _read(self, path: Path) -> dict[str, str]:
        if path not in self._about and path not in self.unreadable:
            try:
                self._about[path] = RecordedFile(path).about
            except DataError as error:
                self.unreadable.add(path)
                sys.stderr.write(f"{error}; it is kept\n")
        return self._about.get(path, {})


class Recorder:
    """Recorder of every topic: on request, and by itself around a fault."""

    def __init__(
        self, bus: Bus, cell: CellConfig, *, wall_ns: Callable[[], int] = time.time_ns
    ) -> None:
        """Subscribe to every topic."""
        self.period_s = 1.0 / STEPS_HZ
        self.trigger = None
        self._section = cell.recorder
        self._status_address = f"{cell.cell}/{topics.ARBITER_STATUS.key}"
        self._taps = [(place, bus.tap(topic, RECORDER_QUEUE)) for place, topic in enumerate(TOPICS)]
        self._ring_buffer = RingBuffer(
            60.0 * self._section.keep_min, round(self._section.memory_MB * MB)
        )
        self._writer = RecordingWriter(cell, bus.clock, wall_ns)
        self._retention = Retention(self._writer.folder, cell.cell)
        self._until_ns: int | None = None  # end of a recording that a fault triggered
        self._state = ""  # of the arbiter, as last received
        self._starts = bus.inbox(topics.RECORD_START)
        self._stops = bus.inbox(topics.RECORD_STOP)
        self._status_publisher = bus.publisher(topics.RECORDER_STATUS)
        self._status_ns = round(NS_PER_S / cell.rates.health_hz)
        self._next_status_ns = 0

    @property
    def fault(self) -> str:
        """Return why it cannot record, empty if it can."""
        return self._writer.fault

    def step(self, now_ns: int) -> None:
        """Receive, store, write, and reply to requests."""
        self._writer.check_space()
        frames = self._receive(now_ns)
        self._ring_buffer.add(frames, now_ns)
        self._writer.add(frames)
        for frame in frames:
            if frame.topic == STATUS_PLACE:
                self._mind(frame, now_ns)
        for start in self._starts.take_all():
            start.reply(self._start(start.request))
        for stop in self._stops.take_all():
            stop.reply(self._stop())
        self._writer.work(WORK_NS)
        is_over = self._until_ns is not None and now_ns >= self._until_ns
        if is_over and not self._writer.waits:
            self._end(0)
        if now_ns >= self._next_status_ns:
            self._next_status_ns = now_ns + self._status_ns
            self._status_publisher.put(self._status(now_ns))

    def counters(self) -> dict[str, int]:
        """Return counts of written, lost and undecodable messages."""
        recording = self._writer.last
        counted = {
            "recording": int(self._writer.recording is not None),
            "unreadable_files": len(self._retention.unreadable),
        }
        if recording is not None:
            counted |= {
                "messages": recording.messages,
                "lost": min(recording.numbering.lost, LARGEST_COUNTER),
                "unshaped": recording.unshaped,
            }
        return counted

    def close(self) -> None:
        """Write the waiting messages, and finish the file."""
        self._end(LAST_WORK_NS)

    def _receive(self, now_ns: int) -> list[Frame]:
        frames = []
        for place, tap in self._taps:
            take = tap.take
            while (data := take()) is not None:
                frames.append(Frame(place, now_ns, data))
        return frames

    def _mind(self, frame: Frame, now_ns: int) -> None:
        """Write the pre-trigger memory when the arbiter has stopped the arm."""
        with suppress(MessageError):
            _, status = decode(frame.data, ArbiterStatus, self._status_address)
            if status.state in STOPPED and self._state not in ("", *STOPPED) and status.trips:
                self._stopped(status.trips[-1].code, now_ns)
            self._state = status.state

    def _stopped(self, code: str, now_ns: int) -> None:
        running = self._writer.recording
        is_asked = running is not None and self._until_ns is None
        if running is not None and not is_asked and running.cause != code:
            self._writer.note(code)
            self._end(LAST_WORK_NS)  # a rare stop gets its own file
        if self._writer.recording is None and self._section.keep_min > 0.0:
            self._begin_stop(code)
        self._writer.note(code)
        if not is_asked:
            self._until_ns = now_ns + round(self._section.after_fault_s * NS_PER_S)

    def _begin_stop(self, code: str) -> None:
        past = self._retention.of_code(code)
        number = past[-1].number + 1 if past else 1
        blocks = self._ring_buffer.blocks()
        if self._writer.begin(stop_label(code), code, blocks, number=number) is not None:
            self._retention.remove_oldest(past, self._section.faults_kept)

    def _start(self, request: RecordRequest) -> Reply:
        running = self._writer.recording
        if running is not None and self._until_ns is None:
            return refusal("already", f"recording to {running.path}")
        self._end(LAST_WORK_NS)  # a request ends a recording that a fault triggered
        past = self._ring_buffer.blocks() if request.past else []
        recording = self._writer.begin(safe_label(request.label), ASKED, past)
        if recording is None:
            return refusal("recording", self.fault)
        return Reply(accepted=True, text=clipped(f"recording to {recording.path}"))

    def _stop(self) -> Reply:
        recording = self._writer.recording
        if recording is None:
            return refusal("already", "nothing is being recorded")
        self._end(LAST_WORK_NS)
        counts = f"{recording.messages} messages, {recording.numbering.lost} lost"
        return Reply(accepted=True, text=clipped(f"{recording.path}: {counts}"))

    def _end(self, longest_ns: int) -> None:
        self._writer.end(longest_ns)
        self._until_ns = None

    def _status(self, now_ns: int) -> RecorderStatus:
        recording = self._writer.last
        status = RecorderStatus(
            valid=not self.fault,
            reason=self.fault,
            code="recording" if self.fault else "",
            memory_s=self._ring_buffer.reaches_s(now_ns),
            memory_bytes=self._ring_buffer.bytes,
            free_bytes=self._writer.free_bytes,
        )
        if recording is None:
            return status
        return status.replaced(
            recording=self._writer.recording is not None,
            cause=recording.cause,
            file=str(recording.path)[-400:],
            file_bytes=recording.file_bytes,
            messages=recording.messages,
            lost=min(recording.numbering.lost, LARGEST_COUNTER),
            recorded_s=(now_ns - recording.since_ns) / NS_PER_S,
        )
