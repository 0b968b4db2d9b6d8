"""Delay and lag of an arm, from its records of commands and poses. Pure.

A command passes a pure delay D and n equal first-order lags whose sum is L. Each command holds
until the next one, so that the answer is a sum over the steps of the command:

    y(t) = offset + sum_k step_k G(t - t_k - D)
    G(t) = 1 - exp(-x) sum_(j<n) x^j / j!,    x = n t / L

D + L, by which all motion is late, is sharp in the records. L^2 / n, by which its corners are
rounded, shows in the corners alone, and n hardly anywhere. So several n are fitted, and the lag is
known as far as they agree (servo.py). A bare servo has one or two lags; behind a moving average of
set points its corners are rounded as by five at most.
"""

from dataclasses import dataclass
from math import factorial, sqrt

import numpy as np

from common.motion.frames import Array
from forcemesh.errors import DataError

STAGES = (1, 2, 5)
LONGEST_S = 0.3  # delay and lag together
START_STEP_S = 0.002
START_SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the lag in their sum: one search from each
SHORTEST_LAG_S = 1e-4
SEARCHES, CONVERGED_S = 40, 1e-6
LEAST_SAMPLES = 20
LEAST_STEP_M, LEAST_WAY_M = 1e-9, 2e-4
LEAST_REST_M = 1e-9  # rounding of a record without noise
WORST_FIT = 0.15  # of the motion's deviation: a larger rest is no delay and lag
MOST_ALIKE = 0.99  # correlation of a residual with the next one


@dataclass(frozen=True, slots=True)
class Steps:
    """A command and what was seen of it, along one axis; times on one clock [s], places [m]."""

    sent_s: Array  # when each command came into force. Shape (N,)
    sent_m: Array
    seen_s: Array  # Shape (M,)
    seen_m: Array


@dataclass(frozen=True, slots=True)
class Fit:
    """Delay and lag with one number of stages; deviations are standard deviations."""

    stages: int
    delay_s: float
    lag_s: float
    rest_m: float  # deviation of what was seen from the model
    sum_deviation_s: float  # of delay + lag
    lag_deviation_s: float

    @property
    def sum_s(self) -> float:
        """Delay and lag together."""
        return self.delay_s + self.lag_s


@dataclass(frozen=True, slots=True)
class _Point:
    """One delay and lag, with what they leave unexplained."""

    delay_s: float
    lag_s: float
    off_m: Array  # seen less model, without its mean. Shape (M,)
    slopes: Array  # of the model by delay and by lag, without their means. Shape (M, 2)

    @property
    def square(self) -> float:
        return float(self.off_m @ self.off_m)


@dataclass(frozen=True, slots=True)
class _Task:
    """What is fitted: the steps of the command, what was seen, and the number of stages."""

    at_s: Array  # of each step. Shape (K,)
    steps_m: Array
    seen_s: Array
    seen_m: Array
    stages: int

    def at(self, delay_s: float, lag_s: float) -> _Point:
        """Return the point of a delay and a lag."""
        n = self.stages
        age_s = np.maximum(self.seen_s[:, None] - delay_s - self.at_s[None, :], 0.0)
        x = n / lag_s * age_s
        left = np.exp(-x)
        model_m = (1.0 - left * sum(x**j / factorial(j) for j in range(n))) @ self.steps_m
        density = np.where(age_s > 0.0, n / lag_s * x ** (n - 1) / factorial(n - 1) * left, 0.0)
        by_lag = (density * age_s / lag_s) @ self.steps_m
        slopes = -np.stack((density @ self.steps_m, by_lag), axis=1)
        off_m = self.seen_m - model_m
        return _Point(delay_s, lag_s, off_m - off_m.mean(), slopes - slopes.mean(axis=0))


def identify(steps: Steps) -> tuple[Fit, ...]:
    """Return delay and lag, once for each of STAGES.

    Raises DataError when the records do not show them.
    """
    _check(steps)
    useful = steps.seen_s > steps.sent_s[0]
    seen_s, seen_m = steps.seen_s[useful], steps.seen_m[useful]
    steps_m = np.diff(steps.sent_m)
    moves = np.abs(steps_m) > LEAST_STEP_M
    sum_s = _start(steps, seen_s, seen_m)
    at_s, steps_m = steps.sent_s[1:][moves], steps_m[moves]
    fits = tuple(_fit(_Task(at_s, steps_m, seen_s, seen_m, n), sum_s) for n in STAGES)
    best = min(fits, key=lambda fit: fit.rest_m)
    share = best.rest_m / float(np.std(seen_m))
    if share > WORST_FIT:
        unlike = f"{100.0 * share:.0f} % of its way is unlike"
        raise DataError(f"the arm did not do what it was told: {unlike}")
    if best.sum_s > LONGEST_S:
        raise DataError(f"the arm follows its commands later than {1e3 * LONGEST_S:.0f} ms")
    return fits


def _fit(task: _Task, sum_s: float) -> Fit:
    """Return the best of the searches that begin with a sum of delay and lag."""
    ends = [_search(task, *start) for start in _shared(sum_s)]
    end = min(ends, key=lambda point: point.square)
    along = [_search(task, *start, lag_too=False) for start in _shared(end.delay_s + end.lag_s)]
    points = ends + along
    best = min(points, key=lambda point: point.square)
    count, square = len(best.off_m), max(best.square, LEAST_REST_M**2)
    alike = float(np.clip(best.off_m[1:] @ best.off_m[:-1] / square, 0.0, MOST_ALIKE))
    samples = count * (1.0 - alike) / (1.0 + alike)
    variance = square / (count - 3) * count / samples
    covariance = np.linalg.pinv(best.slopes.T @ best.slopes) * variance
    unlikely = [sqrt((point.square - best.square) / variance) for point in points]
    return Fit(
        stages=task.stages,
        delay_s=best.delay_s,
        lag_s=best.lag_s,
        rest_m=sqrt(square / count),
        sum_deviation_s=_deviation(
            [point.delay_s + point.lag_s for point in points], covariance.sum(), unlikely
        ),
        lag_deviation_s=_deviation([point.lag_s for point in points], covariance[1, 1], unlikely),
    )


def _deviation(found_s: list[float], local: float, unlikely: list[float]) -> float:
    """Return how far a number is known: no better than the other points looked at are unlikely.

    Few poses, or poses that come in step with the commands, leave several delays and lags that fit
    nearly alike, and the slopes at the best see that one only. So the other ends of the search are
    looked at, and lags of all sizes with the delay that fits each best. A point that fits worse by
    z deviations (likelihood ratio) and lies off by w says w / z: no more than the slopes say, where
    these are all there is.

    Args:
        found_s: The number at each point [s].
        local: Its variance by the slopes at the best one [s^2].
        unlikely: By how many deviations each point fits worse than the best one, which has 0.
    """
    best_s = found_s[unlikely.index(0.0)]
    off_s = [abs(each_s - best_s) for each_s in found_s]
    others = [w / max(1.0, z) for w, z in zip(off_s, unlikely, strict=True)]
    return max(sqrt(max(float(local), 0.0)), *others)


def _shared(sum_s: float) -> list[tuple[float, float]]:
    """Return delays and lags of one sum."""
    return [((1.0 - share) * sum_s, share * sum_s) for share in START_SHARES]


def _search(task: _Task, delay_s: float, lag_s: float, *, lag_too: bool = True) -> _Point:
    """Return where least squares lead from here (Levenberg and Marquardt); by the delay alone?"""
    point, damping = task.at(delay_s, max(lag_s, SHORTEST_LAG_S)), 1e-3
    moves = np.array([1.0, float(lag_too)])
    for _ in range(SEARCHES):
        slopes = point.slopes * moves
        normal = slopes.T @ slopes
        normal = normal + np.diag(damping * normal.diagonal() + 1e-12)
        by_s = np.linalg.solve(normal, slopes.T @ point.off_m)
        then = task.at(
            point.delay_s + float(by_s[0]),  # below zero too: their sum stays right
            max(point.lag_s + float(by_s[1]), SHORTEST_LAG_S),
        )
        if then.square < point.square:
            point, damping = then, 0.2 * damping
        else:
            damping *= 5.0
        if np.abs(by_s).max() < CONVERGED_S:
            break
    return point


def _start(steps: Steps, seen_s: Array, seen_m: Array) -> float:
    """Return by how much the command must be shifted to be most like what was seen [s]."""
    shifts_s = np.arange(START_STEP_S, LONGEST_S, START_STEP_S)
    rests_m = [
        float(np.std(np.interp(seen_s - shift_s, steps.sent_s, steps.sent_m) - seen_m))
        for shift_s in shifts_s
    ]
    return float(shifts_s[np.argmin(rests_m)])


def _check(steps: Steps) -> None:
    if min(len(steps.sent_s), len(steps.seen_s)) < LEAST_SAMPLES:
        raise DataError("too little was heard of commands and poses: is the machine too busy?")
    if np.ptp(steps.sent_m) < LEAST_WAY_M or np.ptp(steps.seen_m) < 0.3 * np.ptp(steps.sent_m):
        raise DataError("the arm did not go the small steps that it was told")
