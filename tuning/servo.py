"""Delay and lag of the arm's servo, combined from repeated rounds of steps. Pure.

Deviations are standard deviations; bounds are two of them away.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from tuning.identify import Fit

REPEATS_S = 0.001  # largest difference of two rounds that count as repeated
LEAST_ROUNDS, MOST_ROUNDS = 2, 5
# Messages are stamped at creation; the servo applies a command at its own next cycle.
STAMPS_S = 0.0005
SPLIT_S = 0.005  # widest range of a lag that counts as separated from the delay
SIGMAS = 2.0

AxisFits = tuple[Fit, ...]  # one for each number of stages
Round = tuple[AxisFits, ...]  # one for each axis


@dataclass(frozen=True, slots=True)
class Servo:
    """Delay and lag of an arm's servo."""

    sum_s: float  # delay and lag together
    deviation_s: float  # of it
    lag_least_s: float
    lag_most_s: float

    @property
    def bound_s(self) -> float:
        """Sum plus two standard deviations: the sum to design gains for."""
        return self.sum_s + SIGMAS * self.deviation_s

    @property
    def least_s(self) -> float:
        """Sum minus two standard deviations."""
        return self.sum_s - SIGMAS * self.deviation_s

    @property
    def is_split(self) -> bool:
        """Whether delay and lag can be separated."""
        return self.lag_most_s - self.lag_least_s <= SPLIT_S

    @property
    def lags_s(self) -> tuple[float, float]:
        """Least and largest lag, limited by the bound of the sum."""
        most_s = min(self.lag_most_s, self.bound_s)
        return min(self.lag_least_s, most_s), most_s

    def lag_near_s(self, lag_s: float) -> float:
        """Return a lag limited to the identified range."""
        least_s, most_s = self.lags_s
        return min(max(lag_s, least_s), most_s)


def rounds_repeat(rounds: Sequence[Round]) -> bool:
    """Return whether the last two rounds agree within REPEATS_S."""
    if len(rounds) < LEAST_ROUNDS:
        return False
    before_s, last_s = sums(rounds)[-2:]
    return abs(last_s - before_s) <= REPEATS_S


def sums(rounds: Sequence[Round]) -> list[float]:
    """Return the sum of each round, the mean over its axes."""
    return [float(np.mean([_best(axis).sum_s for axis in round_])) for round_ in rounds]


def servo_of(rounds: Sequence[Round]) -> Servo:
    """Return the combined result of rounds that agree.

    The deviation contains the spread of rounds and axes, undivided: the axes may differ.
    The lag range covers all numbers of stages: no servo has exactly one of them, and the number
    that fits best under noise gives a lag error of up to 2 ms.
    """
    axes = [axis for round_ in rounds for axis in round_]
    best = [_best(axis) for axis in axes]
    sums_s = np.array([fit.sum_s for fit in best])
    noise_s = np.array([fit.sum_deviation_s for fit in best])
    variance = np.var(sums_s) + np.mean(noise_s**2) / len(best) + STAMPS_S**2
    fits = [fit for axis in axes for fit in axis]
    lags_s = np.array([fit.lag_s for fit in fits])
    bounds_s = np.array([SIGMAS * hypot(fit.lag_deviation_s, STAMPS_S) for fit in fits])
    least_s, most_s = float(np.min(lags_s - bounds_s)), float(np.max(lags_s + bounds_s))
    return Servo(float(np.mean(sums_s)), sqrt(float(variance)), max(least_s, 0.0), most_s)


def _best(axis: AxisFits) -> Fit:
    return min(axis, key=lambda fit: fit.residual_std_m)
