"""The controller's way from a command to its servos: a pure delay, then a moving average."""

import numpy as np

from common.frames import Array


class SetPointLine:
    """Delay and smoothing of joint commands, exact to the tick.

    A command pushed now reaches the servos `delay_ticks` later; the average over
    `smoothing_ticks` then spreads a step over that many ticks.
    """

    def __init__(self, start: Array, *, delay_ticks: int, smoothing_ticks: int) -> None:
        """Fill the line with a command that has held for ever. Shape (6,)."""
        self._delay, self._window = delay_ticks, smoothing_ticks
        self._ring = np.tile(np.asarray(start, dtype=float), (delay_ticks + smoothing_ticks, 1))
        self._head = 0
        self._same = len(self._ring)  # how many of the newest entries are equal

    @property
    def settled(self) -> bool:
        """Whether every command in the line is the same one."""
        return self._same >= len(self._ring)

    def push(self, command: Array) -> Array:
        """Take this tick's command, return this tick's servo set point. Shape (6,)."""
        newest = self._ring[self._head - 1]
        self._same = self._same + 1 if np.array_equal(command, newest) else 1
        self._ring[self._head] = command
        self._head = (self._head + 1) % len(self._ring)
        if self.settled:
            return np.array(command, dtype=float)
        last = self._head - 1 - self._delay
        rows = [(last - k) % len(self._ring) for k in range(self._window)]
        return np.asarray(self._ring[rows].mean(axis=0))
