"""Ring buffer of the last minutes (pre-trigger memory), compressed by the second, size-limited."""

from collections import deque
from typing import NamedTuple

import zstandard

from forcemesh.clock import NS_PER_S
from services.recorder.frames import Frame, frames_of, pack_frames

BLOCK_NS = NS_PER_S
LEVEL = 1  # higher levels cost time without a gain


class Block(NamedTuple):
    """Compressed frames of about one second."""

    first_ns: int
    packed: bytes

    def frames(self) -> list[Frame]:
        """Return its frames."""
        return list(frames_of(zstandard.decompress(self.packed)))


class RingBuffer:
    """Ring buffer of frames, limited by age and by size."""

    def __init__(self, keep_s: float, most_bytes: int) -> None:
        """Start empty; with keep_s 0 nothing is stored."""
        self.bytes = 0
        self._keep_ns = round(keep_s * NS_PER_S)
        self._most_bytes = most_bytes
        self._blocks: deque[Block] = deque()
        self._open: list[Frame] = []

    def add(self, frames: list[Frame], now_ns: int) -> None:
        """Store frames; drop those beyond the limits of age and size."""
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
        """Return the age of the oldest block [s]."""
        return (now_ns - self._blocks[0].first_ns) / NS_PER_S if self._blocks else 0.0

    def blocks(self) -> list[Block]:
        """Return all blocks, the oldest first."""
        if self._open:
            self._seal()
        return list(self._blocks)

    def _seal(self) -> None:
        packed = zstandard.compress(pack_frames(self._open), LEVEL)
        self._blocks.append(Block(self._open[0].at_ns, packed))
        self.bytes += len(packed)
        self._open = []
