"""Oscillation detector: consecutive half waves of the control error that do not decay. Pure.

Half waves are separated by zero crossings. A loop whose gain is too high for its contact
oscillates with a period of about four loop delays. Half waves that are much shorter or longer are
not caused by the loop and are not counted.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from common.config.cell import CellConfig
from common.motion.frames import Array

HALF_WAVES = 10  # five periods
HALF_WAVE_KEPT = 0.9  # a half wave smaller than this share of the last one of its sign decays
DEADBANDS = 10.0  # smaller half waves, in deadbands, are noise or harmless
SHORTEST_HALF_TAU, LONGEST_HALF_TAU = 0.5, 8.0


@dataclass(frozen=True, slots=True)
class OscillationSettings:
    """Least height and range of durations of a half wave."""

    least: Array  # height in N, N, N, N m, N m, N m. Shape (6,)
    shortest_s: float
    longest_s: float

    @classmethod
    def of(cls, cell: CellConfig) -> "OscillationSettings":
        """Return the settings of a cell."""
        deadbands = np.repeat([cell.force.deadband_N, cell.force.deadband_Nm], 3)
        tau_s = cell.loop_delay_s
        return cls(DEADBANDS * deadbands, SHORTEST_HALF_TAU * tau_s, LONGEST_HALF_TAU * tau_s)


def _zeros() -> Array:
    return np.zeros(6)


@dataclass(frozen=True, slots=True)
class HalfWaves:
    """Half waves of six errors, each detected separately. All of shape (6,)."""

    side: Array = field(default_factory=_zeros)  # sign of the error, 0 before the first half wave
    height: Array = field(default_factory=_zeros)  # of the present half wave so far
    age_s: Array = field(default_factory=_zeros)
    last: Array = field(default_factory=_zeros)  # height of the previous half wave
    before_last: Array = field(default_factory=_zeros)  # of the one before it, with this sign
    count: Array = field(default_factory=_zeros)  # consecutive half waves that did not decay

    @property
    def swings(self) -> bool:
        """Whether one of the errors has oscillated for five periods."""
        return bool(max(self.count.tolist()) >= HALF_WAVES)


def follow(swing: HalfWaves, error: Array, dt_s: float, settings: OscillationSettings) -> HalfWaves:
    """Return the half waves after one more sample.

    Args:
        swing: Half waves so far.
        error: Errors of force [N] and torque [N m] beyond their deadbands. Shape (6,).
        dt_s: Time since the last sample.
        settings: Limits of a half wave.
    """
    size, side = np.abs(error), np.sign(error)
    crossed = (side != 0.0) & (side != swing.side)
    height, age_s = np.maximum(swing.height, size), swing.age_s + dt_s
    if not any(crossed.tolist()):
        return replace(swing, height=height, age_s=age_s)
    ended = crossed & (swing.side != 0.0)
    in_time = (swing.age_s >= settings.shortest_s) & (swing.age_s <= settings.longest_s)
    persists = (
        in_time
        & (swing.height >= settings.least)
        & (swing.height >= HALF_WAVE_KEPT * swing.before_last)
    )
    return HalfWaves(
        side=np.where(crossed, side, swing.side),
        height=np.where(crossed, size, height),
        age_s=np.where(crossed, 0.0, age_s),
        last=np.where(ended, swing.height, swing.last),
        before_last=np.where(ended, swing.last, swing.before_last),
        count=np.where(ended, np.where(persists, swing.count + 1.0, 0.0), swing.count),
    )
