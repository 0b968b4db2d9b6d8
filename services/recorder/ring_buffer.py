"""The flight recorder: the last minutes, packed by the second, within a number of bytes."""

from collections import deque
from typing import NamedTuple

import zstandard

from forcemesh.clock import NS_PER_S
from services.recorder.frames import Frame, frames_of, pack_frames

BLOCK_NS = NS_PER_S
LEVEL = 1  # tighter costs time and wins nothing


class Block(NamedTuple):
    """What came within about a second."""

    first_ns: int
    packed: bytes

    def frames(self) -> list[Frame]:
        """Return what is in it."""
        return list(frames_of(zstandard.decompress(self.packed)))


class Past:
    """Keeps what it is shown for so long, or as long as there is room."""

    def __init__(self, keep_s: float, most_bytes: int) -> None:
        """Remember nothing yet; keep_s 0 remembers nothing ever."""
        self.bytes = 0
        self._keep_ns = round(keep_s * NS_PER_S)
        self._most_bytes = most_bytes
        self._blocks: deque[Block] = deque()
        self._open: list[Frame] = []

    def add(self, frames: list[Frame], now_ns: int) -> None:
        """Remember what came; forget what is too old or too much."""
        if self._keep_ns == 0:
            return
        self._open += frames
        if self._open and now_ns - self._open[0].at_ns >= BLOCK_NS:
            self._seal()
        while self._blocks and (
            self.bytes > self._most_bytes or now_ns - self._blocks[0].first_ns > self._keep_ns
        ):
            self.bytes -= len(self._blocks.popleft().packed)

    def reaches_s(self, now_ns: int) -> float:
        """Return how far back it goes [s]."""
        oldest = self._blocks[0].first_ns if self._blocks else None
        return 0.0 if oldest is None else (now_ns - oldest) / NS_PER_S

    def blocks(self) -> list[Block]:
        """Return all that is remembered, the oldest first."""
        if self._open:
            self._seal()
        return list(self._blocks)

    def _seal(self) -> None:
        packed = zstandard.compress(pack_frames(self._open), LEVEL)
        self._blocks.append(Block(self._open[0].at_ns, packed))
        self.bytes += len(packed)
        self._open = []
