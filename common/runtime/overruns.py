"""Counts how often a loop comes far too late to its next step. Pure.

Measured with cells/demo.yaml on two shared cores, longest gap between two steps in 12 s, where
67 ms are allowed (13 ms to 27 ms with a lab's usual deadlines):

    real-time priority, 4 processes that burn the processor   7 ms, no overrun
    without the priority, the same                           59 ms, no overrun
    without it, beside other cells that have it             115 ms, up to 8 in a second
"""

from collections import deque

from common.config.cell import Cell
from forcemesh.clock import NS_PER_S
from forcemesh.topics import TOPICS

WINDOW_NS = 1 * NS_PER_S
# Of the time after which what the role says is stale: two periods where that is three of them.
# A cell on a noisy machine has longer deadlines, and so is judged by them here as well.
ALLOWED_SHARE = 2.0 / 3.0
MOST_OVERRUNS = 3  # within the window; more of them in a loop that commands motion is a fault


def allowed_gap_s(cell: Cell, role: str) -> float | None:
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
        """Note a step."""
        gap_s = 0.0 if self._last_ns is None else (now_ns - self._last_ns) / NS_PER_S
        self._last_ns, self.gap_s = now_ns, gap_s
        if self._allowed_s is not None and gap_s > self._allowed_s:
            self._late_ns.append(now_ns)
        while self._peaks and self._peaks[-1][1] <= gap_s:
            self._peaks.pop()
        self._peaks.append((now_ns, gap_s))
        oldest_ns = now_ns - WINDOW_NS
        while self._peaks[0][0] < oldest_ns:
            self._peaks.popleft()
        while self._late_ns and self._late_ns[0] < oldest_ns:
            self._late_ns.popleft()

    @property
    def count(self) -> int:
        """How many gaps of the last second were too long."""
        return len(self._late_ns)

    @property
    def longest_s(self) -> float:
        """The longest gap of the last second [s]."""
        return self._peaks[0][1] if self._peaks else 0.0
