"""Recording writer: write queue and disk. A disk error does not interrupt reception."""

from collections import deque
from collections.abc import Callable
from contextlib import suppress

from common.config.cell import CellConfig
from forcemesh.clock import NS_PER_S, Clock
from forcemesh.faults import clipped
from services.recorder.folder import STOP, file_name, folder_of, forget_oldest, free_bytes
from services.recorder.frames import Frame
from services.recorder.recording import Recording
from services.recorder.ring_buffer import Block
from services.recorder.stamps import WallClock

SPACE_CHECK_NS = NS_PER_S  # period of the check of free space
GB = 1_000_000_000


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

    def begin(self, label: str, cause: str, ring_buffer: list[Block]) -> bool:
        """Start a recording with the pre-trigger memory; return whether it was started."""
        self.check_space()
        if self._no_space:
            return False
        now_ns = self._clock.now_ns()
        wall_clock = WallClock(self._clock.boot, self._wall_ns() - now_ns)
        name = file_name(self._cell.cell, wall_clock.arrival_ns(now_ns), label)

        def open_it() -> None:
            self.recording = self.last = Recording(
                self.folder, name, self._cell, cause=cause, wall_clock=wall_clock, now_ns=now_ns
            )
            self._broken = ""
            forget_oldest(self.folder, self._cell.cell, label, self._cell.recorder.faults_kept)

        self._waiting = deque(ring_buffer)
        self._try(open_it)
        return self.recording is not None

    def add(self, frames: list[Frame]) -> None:
        """Queue frames for writing, if there is a recording."""
        if self.recording is not None:
            self._waiting.append(frames)

    def note(self, what: str) -> None:
        """Write an event of now into the recording."""
        if (recording := self.recording) is not None:
            self._try(lambda: recording.note(what, self._clock.now_ns()))

    def work(self, longest_ns: int) -> None:
        """Write from the queue for a limited time."""
        give_up_ns = self._clock.now_ns() + longest_ns
        while self._waiting and self.recording is not None:
            waiting = self._waiting.popleft()
            self._write(waiting.frames() if isinstance(waiting, Block) else waiting)
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

    def _write(self, frames: list[Frame]) -> None:
        if (recording := self.recording) is not None:
            self._try(lambda: recording.write(frames, self._clock.now_ns()))

    def _try(self, use: Callable[[], None]) -> None:
        """Run a disk operation; an error ends the recording, and nothing else."""
        try:
            use()
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


def fault_label(code: str) -> str:
    """Return the label of a recording that a fault triggered."""
    return f"{STOP}-{code}"
