"""Overrun counter of a loop: steps that come far too late. Pure.

Measured with cells/demo.yaml on two shared cores, longest gap between two steps in 12 s, where
67 ms were allowed, by deadlines of 100 ms (13 ms to 27 ms with a lab's usual deadlines):

    real-time priority, 4 processes at full CPU load          7 ms, no overrun
    without the priority, the same                           59 ms, no overrun
    without it, next to other cells that have it            115 ms, up to 8 in a second
"""

from collections import deque

from common.config.cell import CellConfig
from forcemesh.clock import NS_PER_S
from forcemesh.topics import TOPICS

OVERRUN_WINDOW_NS = 1 * NS_PER_S
# Share of the stale time of the role's streams: two periods if that is three of them.
# A cell on a loaded machine has longer deadlines and thus a longer permitted gap.
ALLOWED_SHARE = 2.0 / 3.0
MOST_OVERRUNS = 3  # within the window; more in a loop that commands motion is a fault


def allowed_gap_s(cell: CellConfig, role: str) -> float | None:
    """Return the longest time between two steps of a role [s], None for one without a stream."""
    streams = [topic for topic in TOPICS if topic.writer == role and topic.qos == "stream"]
    if not streams:
        return None
    return ALLOWED_SHARE * min(cell.stale_after_s(topic) for topic in streams)


class Overruns:
    """Gaps between the steps of one loop, over the last second."""

    def __init__(self, allowed_s: float | None) -> None:
        """Begin with the next step.

        Args:
            allowed_s: A longer gap [s] is an overrun; None: none is.
        """
        self._allowed_s = allowed_s
        self.gap_s = 0.0  # before the latest step
        self._last_ns: int | None = None
        self._late_ns: deque[int] = deque()  # when a gap was too long
        self._peaks: deque[tuple[int, float]] = deque()  # when and how long, longest first

    def stepped(self, now_ns: int) -> None:
        """Register a step."""
        gap_s = 0.0 if self._last_ns is None else (now_ns - self._last_ns) / NS_PER_S
        self._last_ns, self.gap_s = now_ns, gap_s
        if self.is_late:
            self._late_ns.append(now_ns)
        while self._peaks and self._peaks[-1][1] <= gap_s:
            self._peaks.pop()
        self._peaks.append((now_ns, gap_s))
        oldest_ns = now_ns - OVERRUN_WINDOW_NS
        while self._peaks[0][0] < oldest_ns:
            self._peaks.popleft()
        while self._late_ns and self._late_ns[0] < oldest_ns:
            self._late_ns.popleft()

    @property
    def is_late(self) -> bool:
        """Whether the latest gap was too long."""
        return self._allowed_s is not None and self.gap_s > self._allowed_s

    @property
    def count(self) -> int:
        """Number of overruns in the last second."""
        return len(self._late_ns)

    @property
    def longest_s(self) -> float:
        """Longest gap of the last second [s]."""
        return self._peaks[0][1] if self._peaks else 0.0
