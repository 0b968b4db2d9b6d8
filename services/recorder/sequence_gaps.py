"""Counter of lost messages by sequence gaps of each topic. Pure."""


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
            self.lost += seq - last[1] - 1
        self._last[topic] = (epoch, seq)
