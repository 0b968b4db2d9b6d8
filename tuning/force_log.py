"""Signal of a force log of any robot: its times, its gaps, moving means, even resampling. Pure.

A sample without a value is left out of a signal. It widens a distance of two times, and is never
replaced by a zero.
"""

from dataclasses import dataclass

import numpy as np

from common.motion.frames import Array

LEAST_SAMPLES = 20
ROUNDING_S = 1e-7  # of times since 1970 in double precision
GAP_FACTOR = 3.0  # a distance of more periods than this is a gap


@dataclass(frozen=True, slots=True)
class Signal:
    """Values of one quantity, in N or N m, at their times."""

    time_s: Array  # not decreasing. Shape (N,)
    value: Array  # finite. Shape (N,)

    def between(self, begin_s: float, end_s: float) -> "Signal":
        """Return the samples from `begin_s` to before `end_s`; the end of a signal is included."""
        is_end = len(self.time_s) > 0 and end_s >= self.time_s[-1]
        first = int(np.searchsorted(self.time_s, begin_s, side="left"))
        last = int(np.searchsorted(self.time_s, end_s, side="right" if is_end else "left"))
        return Signal(self.time_s[first:last], self.value[first:last])

    def averaged(self, window_s: float) -> "Signal":
        """Return centred moving means over `window_s`; a window of 0 changes nothing."""
        if window_s <= 0.0:
            return self
        half_s = window_s / 2.0 + ROUNDING_S
        sums = np.concatenate(([0.0], np.cumsum(self.value)))
        first = np.searchsorted(self.time_s, self.time_s - half_s, side="left")
        last = np.searchsorted(self.time_s, self.time_s + half_s, side="right")
        return Signal(self.time_s, (sums[last] - sums[first]) / (last - first))


@dataclass(frozen=True, slots=True)
class Gap:
    """Distance of two samples that is longer than GAP_FACTOR periods."""

    begin_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class Sampling:
    """Evenness of the times of a log."""

    count: int
    duration_s: float
    period_s: float  # median of the distances
    jitter_s: float  # standard deviation of the distances, gaps left out
    worst_s: float  # largest deviation of a distance from the period, gaps left out
    gaps: tuple[Gap, ...]
    repeated: int  # samples with the time of the sample before

    @property
    def rate_hz(self) -> float:
        """Rate that belongs to the period."""
        return 1.0 / self.period_s

    @property
    def missing_s(self) -> float:
        """Time within gaps, beyond one period each."""
        return sum(gap.length_s - self.period_s for gap in self.gaps)


def sampling_of(time_s: Array) -> Sampling:
    """Return the evenness of times [s]; shape (N,), not decreasing, N >= 2, not all equal.

    The period is the median of the distances that are not zero, so that neither gaps nor times
    of a coarse clock change it.
    """
    distances = np.diff(time_s)
    period_s = float(np.median(distances[distances > 0.0]))
    is_gap = distances > GAP_FACTOR * period_s
    regular = distances[~is_gap]
    return Sampling(
        count=len(time_s),
        duration_s=float(time_s[-1] - time_s[0]),
        period_s=period_s,
        jitter_s=float(np.std(regular)),
        worst_s=float(np.max(np.abs(regular - period_s))),
        gaps=tuple(Gap(float(time_s[at]), float(distances[at])) for at in np.flatnonzero(is_gap)),
        repeated=int(np.count_nonzero(distances == 0.0)),
    )


def evenly(signal: Signal, period_s: float) -> Array:
    """Return the longest stretch without a gap, interpolated to even distances of `period_s`."""
    ends = np.flatnonzero(np.diff(signal.time_s) > GAP_FACTOR * period_s)
    bounds = np.concatenate(([0], ends + 1, [len(signal.time_s)]))
    longest = int(np.argmax(np.diff(bounds)))
    time_s = signal.time_s[bounds[longest] : bounds[longest + 1]]
    if len(time_s) == 0:
        return np.empty(0)
    count = int((time_s[-1] - time_s[0]) / period_s + 0.5) + 1
    grid_s = time_s[0] + period_s * np.arange(count)
    values: Array = np.interp(grid_s, signal.time_s, signal.value)
    return values
