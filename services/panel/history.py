"""Ring buffer of the plotted values, with fixed memory; and the ranges of the axes. Pure."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

HISTORY_WINDOW_S = 20.0
HISTORY_POINTS = 400  # most points of a plot; one each 50 ms
PLOT_ROOM = 0.4  # share of an axis range below which the range shrinks


class PlotHistory:
    """Ring buffer of samples of named values; a missing value is a gap (NaN)."""

    def __init__(self, names: tuple[str, ...], points: int = HISTORY_POINTS) -> None:
        """Create an empty buffer."""
        self._column = {name: column for column, name in enumerate(names)}
        self._time_s = np.full(points, np.nan)
        self._values = np.full((points, len(names)), np.nan)
        self._next = 0
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, time_s: float, values: Mapping[str, float]) -> None:
        """Add a sample, overwriting the oldest one when full; missing names are gaps."""
        row = self._next
        self._time_s[row] = time_s
        self._values[row] = np.nan
        for name, value in values.items():
            self._values[row, self._column[name]] = value
        self._next = (row + 1) % len(self._time_s)
        self._count = min(self._count + 1, len(self._time_s))

    def series(self, names: tuple[str, ...], now_s: float) -> tuple[Series, ...]:
        """Return times relative to now [s], oldest first, and the named values, of equal length.

        At least two samples are returned, as a plot needs two; absent ones are gaps.
        """
        order = (self._next - self._count + np.arange(self._count)) % len(self._time_s)
        if self._count < 2:
            edge = np.array([-HISTORY_WINDOW_S, 0.0])
            return (edge, *(np.full(2, np.nan) for _ in names))
        values = self._values[order]
        return (self._time_s[order] - now_s, *(values[:, self._column[name]] for name in names))

    def clear(self) -> None:
        """Remove all samples: data before a pause does not continue after it."""
        self._next = self._count = 0


class Span:
    """Range of a plot axis: round numbers, changed only when the data no longer fits.

    The hysteresis keeps the axis readable.
    """

    def __init__(self, least: float, *, signed: bool = True) -> None:
        """Start with a range above the noise; an unsigned range starts at zero."""
        self._least, self._signed = least, signed
        self.low, self.high = -least if signed else 0.0, least

    def take(self, lines: tuple[Series, ...]) -> bool:
        """Fit the range to these values; return whether it changed."""
        known = np.concatenate([line[np.isfinite(line)] for line in lines] or [np.zeros(1)])
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
        span = (-self._round(-low) if self._signed or low < 0.0 else 0.0, self._round(high))
        too_small = low < self.low or high > self.high
        too_large = span[1] - span[0] < PLOT_ROOM * (self.high - self.low)
        if not (too_small or too_large):
            return False
        changed = span != (self.low, self.high)
        self.low, self.high = span
        return changed

    def _round(self, extent: float) -> float:
        """Return the smallest of 1, 2, 5 times a power of ten above an extent."""
        extent = max(1.05 * extent, self._least)
        power: float = 10.0 ** np.floor(np.log10(extent))
        return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= extent)
