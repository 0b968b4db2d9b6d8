"""Recorder service: receives every topic, keeps the pre-trigger memory, writes on request.

A disk error ends the recording and does not interrupt reception.
"""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.codec import decode
from forcemesh.errors import MessageError
from forcemesh.faults import clipped, refusal
from forcemesh.messages import ArbiterStatus, RecorderStatus
from forcemesh.requests import RecordRequest, Reply
from forcemesh.topics import TOPICS
from services.recorder.folder import Retention, folder_of, free_bytes, safe_label, stop_label
from services.recorder.frames import Frame
from services.recorder.recording import MB, Recording
from services.recorder.ring_buffer import RingBuffer
from services.recorder.stamps import WallClock

STEPS_HZ = 10.0
RECORDER_QUEUE = 4096  # receive queue of one topic: eight seconds of the fastest one
WORK_NS = NS_PER_S // 40  # of each step, for writing
GB = 1_000_000_000
STATUS_PLACE = TOPICS.index(topics.ARBITER_STATUS)
STOPPED = ("HOLDING", "FAULT")
ASKED = "asked"


class Recorder:
    """Recorder of every topic: on request, and by itself around a fault."""

    def __init__(
        self, bus: Bus, cell: CellConfig, *, wall_ns: Callable[[], int] = time.time_ns
    ) -> None:
        """Subscribe to every topic."""
        self.period_s = 1.0 / STEPS_HZ
        self.trigger = None
        self._cell, self._clock, self._wall_ns = cell, bus.clock, wall_ns
        self._section, self._folder = cell.recorder, folder_of(cell)
        self._status_address = f"{cell.cell}/{topics.ARBITER_STATUS.key}"
        self._taps = [(place, bus.tap(topic, RECORDER_QUEUE)) for place, topic in enumerate(TOPICS)]
        self._ring_buffer = RingBuffer(
            60.0 * self._section.keep_min, round(self._section.memory_MB * MB)
        )
        self._retention = Retention(cell)
        self._recording: Recording | None = None
        self._last: Recording | None = None  # the present or the last one
        self._until_ns: int | None = None  # end of a recording that a fault triggered
        self._free_bytes = 0
        self._no_space, self._broken = "", ""
        self._state = ""  # of the arbiter, as last received
        self._starts = bus.inbox(topics.RECORD_START)
        self._stops = bus.inbox(topics.RECORD_STOP)
        self._status_publisher = bus.publisher(topics.RECORDER_STATUS)
        self._status_ns = round(NS_PER_S / cell.rates.health_hz)
        self._next_status_ns = 0

    @property
    def fault(self) -> str:
        """Return why it cannot record, empty if it can."""
        return self._no_space or self._broken

    def step(self, now_ns: int) -> None:
        """Receive, store, write, and reply to requests."""
        frames = [
            Frame(place, now_ns, data) for place, tap in self._taps for data in iter(tap.take, None)
        ]
        self._ring_buffer.add(frames, now_ns)
        if self._recording is not None:
            self._recording.waiting.append(frames)
        for frame in frames:
            if frame.topic == STATUS_PLACE:
                self._mind(frame, now_ns)
        for start in self._starts.take_all():
            start.reply(self._start(start.request))
        for stop in self._stops.take_all():
            stop.reply(self._stop())
        self._write(WORK_NS)
        is_over = self._until_ns is not None and now_ns >= self._until_ns
        if is_over and not (self._recording and self._recording.waiting):
            self._end()
        if now_ns >= self._next_status_ns:
            self._next_status_ns = now_ns + self._status_ns
            self._try(self._check_space)
            self._status_publisher.put(self._status(now_ns))

    def counters(self) -> dict[str, int]:
        """Return counts of written, lost and undecodable messages."""
        counted = {
            "recording": int(self._recording is not None),
            "unreadable_files": len(self._retention.unreadable),
        }
        if self._last is not None:
            counted |= {
                "messages": self._last.messages,
                "lost": self._last.gaps.lost,
                "unshaped": self._last.unshaped,
            }
        return counted

    def close(self) -> None:
        """Write the waiting messages, and finish the file."""
        self._end()

    # --- stops of the arm, and requests -----------------------------------------------------------

    def _mind(self, frame: Frame, now_ns: int) -> None:
        """Write the pre-trigger memory when the arbiter has stopped the arm."""
        with suppress(MessageError):
            _, status = decode(frame.data, ArbiterStatus, self._status_address)
            if status.state in STOPPED and self._state not in ("", *STOPPED) and status.trips:
                self._stopped(status.trips[-1].code, now_ns)
            self._state = status.state

    def _stopped(self, code: str, now_ns: int) -> None:
        is_asked = self._recording is not None and self._until_ns is None
        if self._recording is not None and not is_asked and self._recording.cause != code:
            self._note(code)
            self._end()  # a rare stop gets its own file
        if self._recording is None and self._section.keep_min > 0.0:
            past = self._retention.of_code(code)
            number = past[-1][0] + 1 if past else 1
            blocks, label = self._ring_buffer.blocks, stop_label(code)
            if self._begin(cause=code, past=blocks, label=label, number=number) is not None:
                self._retention.keep_newest(code, self._section.faults_kept)
        self._note(code)
        if not is_asked:
            self._until_ns = now_ns + round(self._section.after_fault_s * NS_PER_S)

    def _start(self, request: RecordRequest) -> Reply:
        if self._recording is not None and self._until_ns is None:
            return refusal("already", f"recording to {self._recording.path}")
        self._end()  # a request ends a recording that a fault triggered
        past = self._ring_buffer.blocks if request.past else ()
        begun = self._begin(cause=ASKED, past=past, label=safe_label(request.label))
        if begun is None:
            return refusal("recording", self.fault)
        return Reply(accepted=True, text=clipped(f"recording to {begun.path}"))

    def _stop(self) -> Reply:
        recording = self._recording
        if recording is None:
            return refusal("already", "nothing is being recorded")
        self._end()
        counts = f"{recording.messages} messages, {recording.gaps.lost} lost"
        return Reply(accepted=True, text=clipped(f"{recording.path}: {counts}"))

    # --- the recording and its disk ---------------------------------------------------------------

    def _begin(self, **about: Any) -> Recording | None:
        """Start a recording if possible; `about` as in Recording."""
        self._try(self._check_space)
        if not self._no_space:
            self._try(self._open, about)
        return self._recording

    def _open(self, about: dict[str, Any]) -> None:
        now_ns = self._clock.now_ns()
        wall_clock = WallClock(self._clock.boot, self._wall_ns() - now_ns)
        self._recording = self._last = Recording(self._cell, wall_clock, now_ns, **about)
        self._broken = ""

    def _note(self, what: str) -> None:
        """Write an event of now into the recording."""
        if self._recording is not None:
            self._try(self._recording.note, what, self._clock.now_ns())

    def _write(self, longest_ns: float = math.inf) -> None:
        """Write what waits, for a limited time."""
        began_ns = now_ns = self._clock.now_ns()
        while self._recording is not None and self._recording.waiting:
            self._try(self._recording.write, self._recording.waiting.popleft(), now_ns)
            now_ns = self._clock.now_ns()
            if now_ns - began_ns >= longest_ns:
                return

    def _end(self) -> None:
        """Write what waits, and finish the file."""
        self._write()
        if self._recording is not None:
            self._try(self._recording.close)
        self._recording = self._until_ns = None

    def _check_space(self) -> None:
        """Measure the free space, and stop before it is used up."""
        self._free_bytes = free_bytes(self._folder)
        free_GB, least_GB = self._free_bytes / GB, self._section.least_free_GB
        if free_GB >= least_GB:
            self._no_space = ""
            return
        stopped = "recording stopped: " if self._recording is not None else ""
        self._no_space = self._no_space or clipped(
            f"{stopped}{free_GB:.1f} GB are free at {self._folder}, "
            f"recorder.least_free_GB is {least_GB:g}"
        )
        self._end()

    def _try(self, use: Callable[..., None], *arguments: Any) -> None:
        """Run a disk operation; an error ends the recording, and nothing else."""
        try:
            use(*arguments)
        except OSError as error:
            self._broken = clipped(f"cannot write to {self._folder}: {error.strerror or error}")
            if self._recording is not None:
                self._recording.abandon()
                self._recording = None

    def _status(self, now_ns: int) -> RecorderStatus:
        recording = self._last
        status = RecorderStatus(
            valid=not self.fault,
            reason=self.fault,
            code="recording" if self.fault else "",
            memory_s=self._ring_buffer.reaches_s(now_ns),
            memory_bytes=self._ring_buffer.bytes,
            free_bytes=self._free_bytes,
        )
        if recording is None:
            return status
        return status.replaced(
            recording=self._recording is not None,
            cause=recording.cause,
            file=str(recording.path)[-400:],
            file_bytes=recording.file_bytes,
            messages=recording.messages,
            lost=recording.gaps.lost,
            recorded_s=(now_ns - recording.since_ns) / NS_PER_S,
        )
