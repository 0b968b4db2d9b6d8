"""Replies of controller/fmprobe.as as values, and the numbers in a trace of samples."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from common.config.probe import LineCheck

SAME_VALUE = 0.01  # between two numbers of a line of forcemesh.as, as fmprobe.as compares them
TEXT_LINE = re.compile(r"(\S+) /(.*)/ /(.*)/")
MIDDLE = (0.25, 0.75)  # share of the travel in which a trace is fitted
LEAST_TRACE_SAMPLES = 5


@dataclass(slots=True)
class ProbeReadings:
    """Values of a reply by name; `failed` has the code of a step that the controller refused."""

    numbers: dict[str, list[float]] = field(default_factory=dict)
    failed: dict[str, int] = field(default_factory=dict)
    checks: dict[str, LineCheck] = field(default_factory=dict)
    samples: list[tuple[float, float]] = field(default_factory=list)  # time [s], travel [mm]
    malformed: list[str] = field(default_factory=list)  # lines that are no result

    @classmethod
    def of(cls, lines: Iterable[str]) -> "ProbeReadings":
        """Return the values in the lines of a reply."""
        found = cls()
        for line in lines:
            try:
                found._take(line)
            except ValueError:
                found.malformed.append(line)
        return found

    def _take(self, line: str) -> None:
        if line.startswith("text.") and (match := TEXT_LINE.fullmatch(line)):
            name, expected, text = match.groups()
            self.checks[name] = LineCheck(expected=expected, found=text, same=text == expected)
            return
        name, *rest = line.split()
        if name.startswith("line."):
            self._check(name, rest)
        elif name == "s":
            time_s, travel_mm = map(_finite, rest)
            self.samples.append((time_s, travel_mm))
        elif rest[:1] == ["?"]:
            self.failed[name] = _code(rest)
        else:
            (value,) = map(_finite, rest)
            self.numbers.setdefault(name, []).append(value)

    def _check(self, name: str, rest: Sequence[str]) -> None:
        expected, *values = rest
        if values[:1] == ["?"]:
            code = f"error {_code(values)}"
            self.checks[name] = LineCheck(expected=expected, found=code, same=False)
            return
        (value,) = map(_finite, values)
        same = abs(value - float(expected)) <= SAME_VALUE
        self.checks[name] = LineCheck(expected=expected, found=f"{value:.8g}", same=same)

    def get(self, name: str) -> float | None:
        """Return the last value of a name, None without one."""
        return self.numbers[name][-1] if self.numbers.get(name) else None


def _finite(text: str) -> float:
    """Return a number. Raises ValueError for another text, also for inf and nan."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _code(words: Sequence[str]) -> int:
    """Return the error code in the words `? code`. Raises ValueError."""
    _, code = words
    return int(_finite(code))


@dataclass(frozen=True, slots=True)
class MotionTrace:
    """Response to a linear motion, from the samples of it."""

    half_s: float  # time of the middle of the travel
    speed_mm_s: float  # there
    spread_s2: float  # variance of delay of the motion's beginning: of lag, and of the ramp


def trace_of(samples: Sequence[tuple[float, float]], travel_mm: float) -> MotionTrace | None:
    """Return when and how fast a motion passes its middle, and how round its beginning is.

    A line through the middle of the trace crosses the start at the mean delay. The area between the
    trace and that line is half the speed times the variance of the delay: tau^2 for a lag tau.

    Args:
        samples: Time since the motion instruction [s], and distance from the start [mm].
        travel_mm: Travel of the motion.

    Returns:
        None if there are too few samples.
    """
    low, high = (share * travel_mm for share in MIDDLE)
    times, travels = np.array(samples, dtype=float).reshape(-1, 2).T
    inside = (travels >= low) & (travels <= high)
    if inside.sum() < LEAST_TRACE_SAMPLES:
        return None
    speed, offset = np.polyfit(times[inside], travels[inside], 1)
    if not speed > 0.0:
        return None
    begin = travels <= high
    above = travels[begin] - np.maximum(0.0, speed * times[begin] + offset)
    spread_s2 = 2.0 * float(np.trapezoid(above, times[begin])) / speed
    half_s = (0.5 * travel_mm - offset) / speed
    return MotionTrace(float(half_s), float(speed), float(spread_s2))


def duration_s(travel_mm: float, speed_mm_s: float, ramp_s: float) -> float:
    """Return how long a motion takes that needs `ramp_s` to its speed and as long to its stop."""
    if speed_mm_s * ramp_s <= travel_mm:
        return travel_mm / speed_mm_s + ramp_s
    return 2.0 * math.sqrt(travel_mm * ramp_s / speed_mm_s)


def ramp_s(travel_mm: float, speed_mm_s: float, *, slower: float, later_s: float) -> float:
    """Return the time to the full speed at ACCEL 100 [s].

    Args:
        travel_mm: Travel of both motions.
        speed_mm_s: Speed of both motions.
        slower: Factor of the ramp of the second one, from its ACCEL and DECEL.
        later_s: How much later the second one passes its middle, which is half of how much longer
            it takes.
    """
    low, high = 0.0, 10.0
    for _ in range(60):
        ramp = 0.5 * (low + high)
        longer_s = duration_s(travel_mm, speed_mm_s, slower * ramp) - duration_s(
            travel_mm, speed_mm_s, ramp
        )
        low, high = (ramp, high) if 0.5 * longer_s < later_s else (low, ramp)
    return 0.5 * (low + high)
