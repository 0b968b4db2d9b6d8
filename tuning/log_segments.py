"""Segments of a force log: from one step of the set point to the next. Pure.

The steps are those of a recorded set point. Without one, or with a constant one, they are found in
the force: the largest difference of the means in two windows, before and after a sample.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array
from tuning.force_log import Signal

JOINED_S = 0.25  # changes of the set point that are closer are one step: a ramp
SAME_SETPOINT = 1e-6  # share of its range below which a change is rounding
WINDOW_SHARE = 0.1  # of the log: length of the windows of the search
LEAST_WINDOW_SHARE = 0.03  # of the log: shorter ones at its ends are not at rest for certain
LEAST_WINDOW = 5  # samples
LEAST_STEP_SHARE = 0.3  # of the range of the force
LEAST_STEP_NOISE = 6.0  # times the standard deviation before the step
SECOND_STEP_SHARE = 0.5  # of the largest step: smaller ones are not steps of their own
REST_SHARE = 0.25  # of the step: largest motion in the second halves of the parts beside it
BLOCKS = 5
START_SHARE = 0.02  # of the step: the force has left its level
START_NOISE = 4.0  # times the noise of single samples
FINAL_SHARE = 0.2  # of a segment: its end, whose median is the final level
MAD_TO_STD = 1.4826

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class LogSegment:
    """Part of a log, in the unit of its signal. `before` is None where no step begins it."""

    begin_s: float
    end_s: float
    before: float | None = None  # level, or set point, before the step
    target: float | None = None  # set point, or final level; None without a step

    @property
    def step(self) -> float | None:
        """Height of the step, with its sign."""
        if self.before is None or self.target is None:
            return None
        return self.target - self.before


def segments_of(signal: Signal, setpoint: Signal | float | None) -> list[LogSegment]:
    """Return the segments of a log, in order.

    Args:
        signal: The judged force or torque.
        setpoint: Recorded set point, constant set point, or None: the final level counts.
    """
    if isinstance(setpoint, Signal):
        if changes := _changes(setpoint):
            return _by_setpoint(signal, setpoint, changes)
        setpoint = float(setpoint.value[-1])
    return _by_force(signal, setpoint)


def _changes(setpoint: Signal) -> list[tuple[int, int]]:
    """Return the first and the last sample of every change; a ramp is one change."""
    least = SAME_SETPOINT * float(np.ptp(setpoint.value))
    found: list[tuple[int, int]] = []
    for at in np.flatnonzero(np.abs(np.diff(setpoint.value)) > least) + 1:
        now = int(at)
        if found and setpoint.time_s[now] - setpoint.time_s[found[-1][1]] < JOINED_S:
            found[-1] = (found[-1][0], now)
        else:
            found.append((now, now))
    return found


def _by_setpoint(
    signal: Signal, setpoint: Signal, changes: list[tuple[int, int]]
) -> list[LogSegment]:
    begins_s = [float(setpoint.time_s[first]) for first, _ in changes]
    ends_s = [*begins_s[1:], float(signal.time_s[-1])]
    segments = [LogSegment(float(signal.time_s[0]), begins_s[0])]
    segments += [
        LogSegment(begin_s, end_s, float(setpoint.value[first - 1]), float(setpoint.value[last]))
        for begin_s, end_s, (first, last) in zip(begins_s, ends_s, changes, strict=True)
    ]
    return [each for each in segments if each.end_s > each.begin_s]


def _by_force(signal: Signal, target: float | None) -> list[LogSegment]:
    steps = steps_in(signal.value)
    begins_s = [float(signal.time_s[at]) for at, _ in steps]
    first_s, last_s = float(signal.time_s[0]), float(signal.time_s[-1])
    segments = [LogSegment(first_s, begins_s[0] if steps else last_s)]
    for (_, before), begin_s, end_s in zip(steps, begins_s, [*begins_s[1:], last_s], strict=False):
        final = _final_level(signal, begin_s, end_s)
        # A constant set point belongs to the steps towards it: a release leads to another level.
        is_aimed = target is not None and abs(final - target) < abs(before - target)
        segments.append(LogSegment(begin_s, end_s, before, target if is_aimed else final))
    return [each for each in segments if each.end_s > each.begin_s]


def _final_level(signal: Signal, begin_s: float, end_s: float) -> float:
    end = signal.between(end_s - FINAL_SHARE * (end_s - begin_s), end_s).value
    whole = signal.between(begin_s, end_s).value
    return float(np.median(end if len(end) else whole[-1:]))  # a gap may be all of the end


def steps_in(value: Array) -> list[tuple[int, float]]:
    """Return sample and level before each step in a force, in order. Shape of `value` (N,).

    A step is at least LEAST_STEP_SHARE of the range, LEAST_STEP_NOISE times the standard deviation
    before it, and SECOND_STEP_SHARE of the largest step. It leads from rest to rest: an oscillation
    is no series of steps. (A slow swing with fewer than five periods in a log is one.)
    """
    window = max(LEAST_WINDOW, int(WINDOW_SHARE * len(value)))
    least = max(LEAST_WINDOW, int(LEAST_WINDOW_SHARE * len(value)))
    at = np.arange(least, len(value) - least)
    if len(at) == 0:
        return []
    before, deviation = _window_means(value, np.maximum(at - window, 0), at)
    after, _ = _window_means(value, at, np.minimum(at + window, len(value)))
    height = np.abs(after - before)
    needed = np.maximum(LEAST_STEP_SHARE * float(np.ptp(value)), LEAST_STEP_NOISE * deviation)
    height = np.where(height >= needed, height, 0.0)
    largest = float(np.max(height))
    found: list[int] = []
    while np.any(height > 0.0) and np.max(height) >= SECOND_STEP_SHARE * largest:
        best = int(np.argmax(height))
        found.append(int(at[best]))
        height[max(best - window, 0) : best + window] = 0.0
    found.sort()
    starts = [_start(value, sample, window) for sample in found]
    begins, ends = [0, *found], [*(sample for sample, _ in starts), len(value)]
    motions = [_motion(value[first:last]) for first, last in zip(begins, ends, strict=True)]
    heights = [abs(float(after[each - at[0]] - before[each - at[0]])) for each in found]
    return [
        start
        for number, start in enumerate(starts)
        if max(motions[number : number + 2]) < REST_SHARE * heights[number]
    ]


def _motion(part: Array) -> float:
    """Return the motion in the second half of a part: slow, or faster than its blocks."""
    half = part[len(part) // 2 :]
    means = [float(np.mean(block)) for block in np.array_split(half, min(BLOCKS, len(half)))]
    return max(max(means) - min(means), float(np.std(half)))


def _window_means(value: Array, first: Indices, last: Indices) -> tuple[Array, Array]:
    """Return mean and standard deviation of `value[first:last]` for arrays of bounds."""
    centred = value - np.mean(value)  # against cancellation in the squares
    sums = np.concatenate(([0.0], np.cumsum(centred)))
    squares = np.concatenate(([0.0], np.cumsum(centred * centred)))
    count = last - first
    mean = (sums[last] - sums[first]) / count
    variance = (squares[last] - squares[first]) / count - mean * mean
    return mean + np.mean(value), np.sqrt(np.maximum(variance, 0.0))


def _start(value: Array, sample: int, window: int) -> tuple[int, float]:
    """Return the last sample at the level before a step, and this level."""
    level = float(np.median(value[max(sample - window, 0) : sample]))
    height = abs(float(np.median(value[sample : sample + window])) - level)
    steps = np.diff(value[max(sample - window, 0) : sample])
    noise = MAD_TO_STD * float(np.median(np.abs(steps - np.median(steps)))) / np.sqrt(2.0)
    near = np.abs(value[: sample + 1] - level) <= max(START_SHARE * height, START_NOISE * noise)
    return max(np.flatnonzero(near).tolist(), default=sample), level
