"""Rounds of steps put together: how late the arm is, and how well that is known. Pure.

Deviations are standard deviations, and what follows from them is good for two of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from tuning.identify import Fit

REPEATS_S = 0.001  # two rounds that are no farther apart are the same
LEAST_ROUNDS, MOST_ROUNDS = 2, 5
# Stamps are of when a message was made, and a servo takes a command at its own next turn.
STAMPS_S = 0.0005
SPLIT_S = 0.005  # a lag whose range is no wider is told apart from the delay
SIGMAS = 2.0

AxisFits = tuple[Fit, ...]  # one for each number of stages
Round = tuple[AxisFits, ...]  # one for each axis


@dataclass(frozen=True, slots=True)
class Servo:
    """How late an arm is."""

    sum_s: float  # delay and lag together
    deviation_s: float  # of it
    lag_least_s: float
    lag_most_s: float

    @property
    def bound_s(self) -> float:
        """Sum that gains should be safe for."""
        return self.sum_s + SIGMAS * self.deviation_s

    @property
    def least_s(self) -> float:
        """Sum that it is not likely to be below."""
        return self.sum_s - SIGMAS * self.deviation_s

    @property
    def is_split(self) -> bool:
        """Whether delay and lag can be told apart."""
        return self.lag_most_s - self.lag_least_s <= SPLIT_S

    @property
    def lags_s(self) -> tuple[float, float]:
        """The least and the largest lag of a sum that is no longer than its bound."""
        most_s = min(self.lag_most_s, self.bound_s)
        return min(self.lag_least_s, most_s), most_s

    def lag_near_s(self, lag_s: float) -> float:
        """Return the lag of the range that is nearest to another one."""
        least_s, most_s = self.lags_s
        return min(max(lag_s, least_s), most_s)


def repeats(rounds: Sequence[Round]) -> bool:
    """Tell whether the last two rounds are the same."""
    if len(rounds) < LEAST_ROUNDS:
        return False
    before_s, last_s = sums(rounds)[-2:]
    return abs(last_s - before_s) <= REPEATS_S


def sums(rounds: Sequence[Round]) -> list[float]:
    """Return the sum of each round, the mean over its axes."""
    return [float(np.mean([_best(axis).sum_s for axis in one])) for one in rounds]


def servo_of(rounds: Sequence[Round]) -> Servo:
    """Return what rounds that agree show together.

    The deviation contains how far rounds and axes are apart, undivided: axes may really differ.
    The lag may be that of any number of stages: no servo is exactly one of them, and the number
    that fits best, where noise leaves one, gives a lag that is up to 2 ms wrong.
    """
    axes = [axis for one in rounds for axis in one]
    best = [_best(axis) for axis in axes]
    sums_s = np.array([fit.sum_s for fit in best])
    noise_s = np.array([fit.sum_deviation_s for fit in best])
    variance = np.var(sums_s) + np.mean(noise_s**2) / len(best) + STAMPS_S**2
    fits = [fit for axis in axes for fit in axis]
    lags_s = np.array([fit.lag_s for fit in fits])
    unsure_s = np.array([SIGMAS * hypot(fit.lag_deviation_s, STAMPS_S) for fit in fits])
    least_s, most_s = float(np.min(lags_s - unsure_s)), float(np.max(lags_s + unsure_s))
    return Servo(float(np.mean(sums_s)), sqrt(float(variance)), max(least_s, 0.0), most_s)


def _best(axis: AxisFits) -> Fit:
    return min(axis, key=lambda fit: fit.rest_m)
