"""Ring buffer: the last minutes of all frames, compressed step by step, limited by age and size."""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import zstandard

from forcemesh.clock import NS_PER_S
from services.recorder.frames import Frame, frames_of, pack_frames

COMPRESS = zstandard.ZstdCompressor(level=1).compress  # higher levels cost time without a gain


class Block(NamedTuple):
    """Compressed frames of one step."""

    at_ns: int
    packed: bytes

    def frames(self) -> Iterator[Frame]:
        """Yield its frames; it is decompressed with the first one."""
        yield from frames_of(zstandard.decompress(self.packed))


class RingBuffer:
    """Ring buffer of frames, limited by age and by size."""

    def __init__(self, keep_s: float, most_bytes: int) -> None:
        """Start empty; with keep_s 0 nothing is stored."""
        self.bytes = 0
        self.blocks: deque[Block] = deque()  # the oldest first
        self._keep_ns = round(keep_s * NS_PER_S)
        self._most_bytes = most_bytes

    def add(self, frames: list[Frame], now_ns: int) -> None:
        """Store frames; drop those beyond the limits of age and size."""
        if frames and self._keep_ns:
            self.blocks.append(Block(now_ns, COMPRESS(pack_frames(frames))))
            self.bytes += len(self.blocks[-1].packed)
        while self.bytes > self._most_bytes or self.reaches_s(now_ns) * NS_PER_S > self._keep_ns:
            self.bytes -= len(self.blocks.popleft().packed)

    def reaches_s(self, now_ns: int) -> float:
        """Return the age of the oldest block [s]."""
        return (now_ns - self.blocks[0].at_ns) / NS_PER_S if self.blocks else 0.0
