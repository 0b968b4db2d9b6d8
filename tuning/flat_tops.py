"""Flat tops of a force: samples clipped at a common extreme value. Pure.

A sensor, a converter or a limit in software clips a signal at one value, so that many samples in a
row are equal there, and the signal enters or leaves this value at full slope. A coarse resolution,
samples that are repeated, and a force that comes to rest also give equal samples; three conditions
leave them out (`flat_tops`).
"""

from dataclasses import dataclass

import numpy as np

from common.motion.frames import Array

LEAST_RUN = 3  # equal samples in a row
EDGE_LEVELS = 8  # beside a run, within which it is entered or left
LEAST_RESOLUTIONS = 9.0  # height of the edge in steps of the resolution: more than EDGE_LEVELS
LEAST_SLOPE_SHARE = 0.3  # height of the edge in median changes between samples
LEAST_SAMPLES_CLIPPED = 5
NEXT_LEVELS = 2  # of a coarse resolution; unclipped, an extreme level is rarer than the next ones


@dataclass(frozen=True, slots=True)
class FlatTop:
    """Clipping of a signal at its largest or smallest value, in its unit."""

    value: float
    places: int  # runs of equal samples
    samples: int  # in these runs
    longest: int  # samples of the longest run


@dataclass(frozen=True, slots=True)
class _Runs:
    """Runs of equal samples: the first sample and the number of samples of each. Shape (R,)."""

    first: Array
    length: Array


def flat_tops(value: Array) -> list[FlatTop]:
    """Return the clipping at the largest and the smallest value of a signal. Shape (N,).

    A run counts that has at least LEAST_RUN samples, and this many times the usual number of
    repeated samples, if the signal leaves or reaches its value somewhere by LEAST_RESOLUTIONS steps
    of the resolution and by LEAST_SLOPE_SHARE of the median change, and if this value is not rarer
    than the NEXT_LEVELS beside it. A value of exactly 0 is the absence of contact, and a signal
    that never changes has no top.
    """
    low, high = float(np.min(value)), float(np.max(value))
    if low == high:
        return []
    runs = _runs(value)
    tops = [_top(value, runs, extreme) for extreme in (high, low) if extreme != 0.0]
    return [top for top in tops if top is not None]


def is_constant(value: Array) -> bool:
    """Return whether a signal never changes: a channel that is not connected."""
    return bool(np.ptp(value) == 0.0)


def _runs(value: Array) -> _Runs:
    first = np.concatenate(([0], np.flatnonzero(np.diff(value)) + 1))
    return _Runs(first, np.diff(np.concatenate((first, [len(value)]))))


def _top(value: Array, runs: _Runs, extreme: float) -> FlatTop | None:
    usual = int(np.median(runs.length))  # 4 where each sample of a sensor is logged four times
    is_here = value[runs.first] == extreme
    changes = np.abs(np.diff(value[runs.first]))
    resolution = _resolution(value)
    least = max(LEAST_RESOLUTIONS * resolution, LEAST_SLOPE_SHARE * float(np.median(changes)))
    is_steep = any(_edge(value[runs.first], int(at)) >= least for at in np.flatnonzero(is_here))
    lengths = [int(each) for each in runs.length[is_here] if each >= LEAST_RUN * usual]
    distance = np.abs(value - extreme)
    is_beside = (distance > 0.0) & (distance < (NEXT_LEVELS + 0.5) * resolution)
    if not is_steep or sum(lengths) < max(LEAST_SAMPLES_CLIPPED, int(np.sum(is_beside))):
        return None
    return FlatTop(extreme, len(lengths), sum(lengths), max(lengths))


def _edge(levels: Array, at: int) -> float:
    """Return the largest change within EDGE_LEVELS before or after a run.

    With noise the level beside a run may by chance be close to it, or touch it again.
    """
    beside = levels[max(at - EDGE_LEVELS, 0) : at + EDGE_LEVELS + 1]
    return float(np.max(np.abs(beside - levels[at])))


def _resolution(value: Array) -> float:
    """Return the least difference of two values that occur, 0 where almost all values differ."""
    levels = np.unique(value)
    if len(levels) > len(value) / 4:
        return 0.0
    return float(np.median(np.diff(levels)))
