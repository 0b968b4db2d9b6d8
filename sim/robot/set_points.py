"""Set-point line from command to servo: dead time, then a moving average."""

import numpy as np

from common.motion.frames import Array


class SetPointLine:
    """Dead time and smoothing of joint commands in a ring buffer, exact to the tick.

    A command pushed now reaches the servos `delay_ticks` later; the average over
    `smoothing_ticks` then spreads a step over that many ticks.
    """

    def __init__(self, start: Array, *, delay_ticks: int, smoothing_ticks: int) -> None:
        """Fill the line with a constant command. Shape (6,)."""
        self._newest = np.array(start, dtype=float)
        self._ring = np.tile(self._newest, (delay_ticks + smoothing_ticks, 1))
        self._head = 0
        self._same = len(self._ring)  # how many of the newest entries are equal
        last = np.arange(len(self._ring))[:, None] - 1 - delay_ticks  # by where the head is
        self._averaged = (last - np.arange(smoothing_ticks)) % len(self._ring)

    @property
    def settled(self) -> bool:
        """Whether all commands in the line are equal."""
        return self._same >= len(self._ring)

    def push(self, command: Array) -> Array:
        """Take this tick's command, return this tick's servo set point. Shape (6,).

        The caller must not modify a command in place: an identical object is not compared again.
        """
        is_same = command is self._newest or command.tolist() == self._newest.tolist()
        self._same = self._same + 1 if is_same else 1
        self._newest = command
        if self._same > len(self._ring):  # the ring is already full of this command
            return command
        self._ring[self._head] = command
        self._head = (self._head + 1) % len(self._ring)
        if self.settled:
            return command
        rows = self._ring.take(self._averaged[self._head], axis=0)
        return np.asarray(np.add.reduce(rows, axis=0) / len(rows))
