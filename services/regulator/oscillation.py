"""Tells a loop that swings from one that settles: half waves that do not die out. Pure.

A loop whose gain is too high for what it touches swings with a period of about four times its
delay. What is faster or slower than that by far is not the loop's own, and is not counted.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from common.config.cell import Cell
from common.motion.frames import Array

HALF_WAVES = 10  # five periods
KEPT = 0.9  # a half wave that is smaller than this part of the last one on its side dies out
DEADBANDS = 10.0  # a half wave below so many deadbands is noise, or harmless
SHORTEST_HALF_TAU, LONGEST_HALF_TAU = 0.5, 8.0


@dataclass(frozen=True, slots=True)
class SwingSettings:
    """What counts as a half wave of this loop."""

    least: Array  # height in N, N, N, N m, N m, N m. Shape (6,)
    shortest_s: float
    longest_s: float

    @classmethod
    def of(cls, cell: Cell) -> "SwingSettings":
        """Take them out of a cell file."""
        deadbands = np.repeat([cell.force.deadband_N, cell.force.deadband_Nm], 3)
        tau_s = cell.loop_delay_s
        return cls(DEADBANDS * deadbands, SHORTEST_HALF_TAU * tau_s, LONGEST_HALF_TAU * tau_s)


def _zeros() -> Array:
    return np.zeros(6)


@dataclass(frozen=True, slots=True)
class Swing:
    """Half waves of six errors, each by itself. All of shape (6,)."""

    side: Array = field(default_factory=_zeros)  # on which the error is: -1, 0 before the first, 1
    height: Array = field(default_factory=_zeros)  # of the half wave under way, so far
    age_s: Array = field(default_factory=_zeros)
    last: Array = field(default_factory=_zeros)  # height of the half wave before
    before_last: Array = field(default_factory=_zeros)  # and of the one before, on this side
    count: Array = field(default_factory=_zeros)  # half waves in a row that did not die out

    @property
    def swings(self) -> bool:
        """Whether some error has swung for five periods."""
        return bool(max(self.count.tolist()) >= HALF_WAVES)


def follow(swing: Swing, error: Array, dt_s: float, settings: SwingSettings) -> Swing:
    """Return the half waves after one more sample.

    Args:
        swing: Half waves so far.
        error: Errors of force [N] and torque [N m] beyond their deadbands. Shape (6,).
        dt_s: Time since the last sample.
        settings: What counts.
    """
    size, side = np.abs(error), np.sign(error)
    crossed = (side != 0.0) & (side != swing.side)
    height, age_s = np.maximum(swing.height, size), swing.age_s + dt_s
    if not any(crossed.tolist()):
        return replace(swing, height=height, age_s=age_s)
    ended = crossed & (swing.side != 0.0)
    in_time = (swing.age_s >= settings.shortest_s) & (swing.age_s <= settings.longest_s)
    lives = in_time & (swing.height >= settings.least) & (swing.height >= KEPT * swing.before_last)
    return Swing(
        side=np.where(crossed, side, swing.side),
        height=np.where(crossed, size, height),
        age_s=np.where(crossed, 0.0, age_s),
        last=np.where(ended, swing.height, swing.last),
        before_last=np.where(ended, swing.last, swing.before_last),
        count=np.where(ended, np.where(lives, swing.count + 1.0, 0.0), swing.count),
    )
