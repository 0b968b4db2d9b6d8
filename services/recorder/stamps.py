"""Sequence numbers and stamps of received headers: lost messages, and wall clock times. Pure.

Within one recording each clock has one constant offset: order and intervals of the messages of one
machine are preserved, also when its wall clock is set meanwhile.
"""

from forcemesh.clock import NS_PER_S

LONGEST_TRANSIT_NS = 600 * NS_PER_S  # a stamp farther than this from its arrival is rejected
MOST_CLOCKS = 64  # an unexpected publisher could name a new one with every message
LARGEST_COUNTER = 2**53  # largest integer that every language represents exactly


class WallClock:
    """Conversion of stamps to this machine's wall clock."""

    def __init__(self, boot: str, offset_ns: int) -> None:
        """Store the offset of this machine's clock; those of others follow from their messages.

        Args:
            boot: The clock's identity, as in headers.
            offset_ns: Wall clock less monotonic clock [ns].
        """
        self.boot = boot
        self.offsets_ns = {boot: offset_ns}

    def arrival_ns(self, at_ns: int) -> int:
        """Return the wall clock time of a time of this machine's monotonic clock [ns]."""
        return at_ns + self.offsets_ns[self.boot]

    def written_ns(self, boot: str, stamp_ns: int, at_ns: int) -> int:
        """Return the wall clock time at which a message was written [ns].

        Args:
            boot: The clock of its stamp.
            stamp_ns: Its stamp; an implausible one is replaced by the arrival.
            at_ns: Its arrival on this machine's monotonic clock [ns].
        """
        came_ns = self.arrival_ns(at_ns)
        offset_ns = self.offsets_ns.get(boot)
        if offset_ns is None:
            offset_ns = came_ns - stamp_ns
            if len(self.offsets_ns) < MOST_CLOCKS:
                self.offsets_ns[boot] = offset_ns
        written_ns = stamp_ns + offset_ns
        return written_ns if abs(written_ns - came_ns) < LONGEST_TRANSIT_NS else came_ns


class SequenceGaps:
    """Sequence gaps of every topic, across restarts of the publishers."""

    def __init__(self) -> None:
        """Start without messages."""
        self.lost = 0
        self._last: dict[int, tuple[int, int]] = {}  # topic: publisher's epoch, sequence number

    def saw(self, topic: int, epoch: int, seq: int) -> None:
        """Count the messages missing before this one."""
        last = self._last.get(topic)
        if last is not None and last[0] == epoch:
            if seq <= last[1]:
                return  # late or repeated
            self.lost = min(self.lost + seq - last[1] - 1, LARGEST_COUNTER)
        self._last[topic] = (epoch, seq)
