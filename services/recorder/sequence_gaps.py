"""How many messages were lost, by the gaps in the numbers that writers give them. Pure."""


class Numbering:
    """Follows the numbers of every topic, through restarts of their writers."""

    def __init__(self) -> None:
        """Have heard nothing."""
        self.lost = 0
        self._last: dict[int, tuple[int, int]] = {}  # topic: writer's epoch, number

    def saw(self, topic: int, epoch: int, seq: int) -> None:
        """Count what is missing before this message of a writer."""
        last = self._last.get(topic)
        if last is not None and last[0] == epoch:
            if seq <= last[1]:
                return  # late, or said again
            self.lost += seq - last[1] - 1
        self._last[topic] = (epoch, seq)
