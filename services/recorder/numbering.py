"""How many messages were lost, by the gaps in the numbers that writers give them. Pure."""

from typing import Any


class Numbering:
    """Follows the numbers of every topic, through restarts of their writers."""

    def __init__(self) -> None:
        """Have heard nothing."""
        self.lost = 0
        self._last: dict[int, tuple[int, int]] = {}  # topic: writer's epoch, number

    def saw(self, topic: int, fields: dict[str, Any]) -> int:
        """Count what is missing before this message; return its number, 0 if it has none."""
        epoch, seq = fields.get("epoch"), fields.get("seq")
        if type(epoch) is not int or type(seq) is not int:
            return 0
        last = self._last.get(topic)
        if last is not None and last[0] == epoch:
            self.lost += max(seq - last[1] - 1, 0)
            seq_then = max(seq, last[1])
        else:
            seq_then = seq
        self._last[topic] = (epoch, seq_then)
        return seq
