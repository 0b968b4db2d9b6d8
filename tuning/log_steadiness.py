"""Steadiness of a force: ripple, drift with its confidence, dominant frequencies. Pure."""

from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist

import numpy as np

from common.motion.frames import Array
from tuning.force_log import Signal, evenly

CONFIDENCE = 0.95  # of the interval of a drift
LEAST_EFFECTIVE = 4.0  # effective samples of a drift with an interval
MOST_LAG_ONE = 0.999  # of successive residuals
LEAST_SPECTRUM = 64  # samples
LONGEST_BLOCK = 4096  # samples
FALSE_ALARM = 1e-3  # probability of a peak in a log of noise alone
LOBE = 3  # bins on each side of a peak that are its own: the main lobe of Hann's window
FLOOR_BINS = 10  # bins on each side from which the floor is taken
LEAST_FLOOR_BINS = 3
FIRST_BIN = 1 + LOBE + LEAST_FLOOR_BINS  # of a peak: 14 periods in the shortest signal
MOST_PEAKS = 5
OVERLAPPED = 9.0 / 11.0  # independent share of blocks that overlap by half (Welch 1967)


@dataclass(frozen=True, slots=True)
class Drift:
    """Slope of a straight line through a force, in its unit per second."""

    slope: float
    bound: float | None  # half the width of the interval of CONFIDENCE; None: too few samples

    @property
    def is_significant(self) -> bool:
        """Whether the interval excludes a slope of zero."""
        return self.bound is not None and abs(self.slope) > self.bound


@dataclass(frozen=True, slots=True)
class Peak:
    """Dominant frequency of a force."""

    frequency_hz: float
    amplitude: float  # of a sine of this power


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Power spectral density by Welch's method, one-sided."""

    frequency_hz: Array  # Shape (M,)
    density: Array  # unit squared per Hz. Shape (M,)
    peaks: tuple[Peak, ...]  # the largest first


def ripple_of(signal: Signal) -> float:
    """Return the RMS of a force about its straight line (least squares)."""
    _, residual = _line(signal)
    return float(np.sqrt(np.mean(residual * residual)))


def drift_of(signal: Signal) -> Drift:
    """Return the slope of the least-squares line, with its interval of CONFIDENCE.

    Successive residuals of a force are correlated. The interval therefore counts effective samples,
    n (1 - r) / (1 + r) with r the correlation of successive residuals (Santer et al. 2000, J.
    Geophys. Res. 105, D6, equation 6).
    """
    slope, residual = _line(signal)
    square = float(residual @ residual)
    if square == 0.0:
        return Drift(slope, 0.0)
    correlation = float(np.clip(residual[1:] @ residual[:-1] / square, 0.0, MOST_LAG_ONE))
    effective = len(residual) * (1.0 - correlation) / (1.0 + correlation)
    if effective < LEAST_EFFECTIVE:
        return Drift(slope, None)
    centred_s = signal.time_s - np.mean(signal.time_s)
    deviation = sqrt(square / (effective - 2.0) / float(centred_s @ centred_s))
    return Drift(slope, student_quantile(0.5 + CONFIDENCE / 2.0, effective - 2.0) * deviation)


def student_quantile(probability: float, freedom: float) -> float:
    """Return a quantile of Student's distribution (Abramowitz and Stegun 1964, 26.7.5)."""
    z = NormalDist().inv_cdf(probability)
    return (
        z
        + (z**3 + z) / (4.0 * freedom)
        + (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / (96.0 * freedom**2)
        + (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / (384.0 * freedom**3)
    )


def spectrum_of(signal: Signal, period_s: float) -> Spectrum | None:
    """Return the spectrum of a force about its straight line; None for too few samples.

    Welch 1967, IEEE Trans. Audio Electroacoust. 15(2): blocks of at most half the samples that
    overlap by half, each without its mean and with Hann's window. The samples are the longest
    stretch without a gap, interpolated to even distances.

    Args:
        signal: The force.
        period_s: Period of its samples.
    """
    value = evenly(signal, period_s)
    if len(value) < LEAST_SPECTRUM:
        return None
    times_s = period_s * np.arange(len(value), dtype=np.float64)
    _, residual = _line(Signal(times_s, value))
    length = min(LONGEST_BLOCK, len(value) // 2)
    starts = range(0, len(value) - length + 1, length // 2)
    window = np.hanning(length + 1)[:-1]  # periodic
    blocks = np.stack([residual[at : at + length] for at in starts])
    blocks = (blocks - blocks.mean(axis=1, keepdims=True)) * window
    power = np.mean(np.abs(np.fft.rfft(blocks, axis=1)) ** 2, axis=0)
    density = 2.0 * power * period_s / float(window @ window)
    frequency_hz = np.arange(len(density), dtype=np.float64) / (length * period_s)
    freedom = 2.0 * max(1.0, OVERLAPPED * len(blocks))
    peaks = _peaks(density, float(frequency_hz[1]), freedom)
    return Spectrum(frequency_hz, density, peaks)


def _peaks(density: Array, bin_hz: float, freedom: float) -> tuple[Peak, ...]:
    """Return the peaks that noise alone would reach with a probability of FALSE_ALARM.

    Of noise, a density divided by its mean is distributed as chi-squared over its degrees of
    freedom. The mean is that of the bins beside the peak, from their median.
    """
    shape = 2.0 / (9.0 * freedom)  # Wilson and Hilferty 1931: quantiles of chi-squared
    z = NormalDist().inv_cdf(1.0 - FALSE_ALARM / len(density))
    factor = ((1.0 - shape + z * sqrt(shape)) / (1.0 - shape)) ** 3
    inner = np.arange(FIRST_BIN, len(density) - 1)
    is_top = (density[inner] > density[inner - 1]) & (density[inner] >= density[inner + 1])
    found = []
    for at in inner[is_top]:
        floor = _floor(density, int(at))
        if density[at] > factor * floor:
            lobe = density[at - LOBE : at + LOBE + 1]
            square = max(float(np.sum(lobe - floor)) * bin_hz, 0.0)
            found.append(Peak(bin_hz * (at + _offset(density, int(at))), sqrt(2.0 * square)))
    return tuple(sorted(found, key=lambda peak: -peak.amplitude)[:MOST_PEAKS])


def _floor(density: Array, at: int) -> float:
    """Return the larger of the medians on both sides, so that a slope is no peak."""
    left = density[max(1, at - LOBE - FLOOR_BINS) : max(1, at - LOBE)]
    right = density[at + LOBE + 1 : at + LOBE + 1 + FLOOR_BINS]
    sides = [float(np.median(side)) for side in (left, right) if len(side) >= LEAST_FLOOR_BINS]
    return max(sides, default=float(np.median(density)))


def _offset(density: Array, at: int) -> float:
    """Return the vertex of the parabola through three logarithms, in bins from the middle one."""
    low, middle, high = np.log(np.maximum(density[at - 1 : at + 2], 1e-300))
    curvature = float(low - 2.0 * middle + high)
    return 0.5 * float(low - high) / curvature if curvature < 0.0 else 0.0


def _line(signal: Signal) -> tuple[float, Array]:
    """Return slope and residual of the least-squares line."""
    centred_s = signal.time_s - np.mean(signal.time_s)
    centred = signal.value - np.mean(signal.value)
    square = float(centred_s @ centred_s)
    slope = float(centred_s @ centred) / square if square > 0.0 else 0.0
    return slope, centred - slope * centred_s
