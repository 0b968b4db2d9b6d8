"""System identification: delay and lag of an arm, from records of commands and poses. Pure.

The model is a dead time D in series with n equal first-order lags whose sum is L. Each command
holds until the next one (zero-order hold), so that the response is a sum over its steps:

    y(t) = offset + sum_k step_k G(t - t_k - D)
    G(t) = 1 - exp(-x) sum_(j<n) x^j / j!,    x = n t / L

D + L, the total delay of all motion, is well determined. L^2 / n determines the rounding of
corners only, and n is hardly observable. So several n are fitted, and the lag is known as far as
they agree (servo.py). A bare servo has one or two lags; a moving average of set points rounds the
corners like five at most.
"""

from dataclasses import dataclass
from math import factorial, sqrt

import numpy as np

from common.motion.frames import Array
from forcemesh.errors import DataError

STAGES = (1, 2, 5)
LONGEST_DELAY_S = 0.3  # delay and lag together
START_STEP_S = 0.002
START_SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)  # share of the lag in the sum: one search from each
SHORTEST_LAG_S = 1e-4
SEARCHES, CONVERGED_S = 40, 1e-6
LEAST_SAMPLES = 20
LEAST_STEP_M, LEAST_TRAVEL_M = 1e-9, 2e-4
LEAST_RESIDUAL_M = 1e-9  # rounding error of a record without noise
WORST_FIT = 0.15  # largest residual, as a share of the motion's standard deviation
MOST_CORRELATION = 0.99  # largest correlation of successive residuals


@dataclass(frozen=True, slots=True)
class Steps:
    """Commanded and measured position along one axis [m]; times on one clock [s]."""

    commanded_s: Array  # when each command took effect. Shape (N,)
    commanded_m: Array
    measured_s: Array  # Shape (M,)
    measured_m: Array


@dataclass(frozen=True, slots=True)
class Fit:
    """Fitted delay and lag for one number of stages; deviations are standard deviations."""

    stages: int
    delay_s: float
    lag_s: float
    residual_std_m: float  # standard deviation of the residual
    sum_deviation_s: float  # of delay + lag
    lag_deviation_s: float

    @property
    def sum_s(self) -> float:
        """Delay and lag together."""
        return self.delay_s + self.lag_s


@dataclass(frozen=True, slots=True)
class _Point:
    """One delay and lag, with residuals and Jacobian."""

    delay_s: float
    lag_s: float
    residual_m: Array  # measured minus model, without its mean. Shape (M,)
    slopes: Array  # of the model by delay and by lag, without their means. Shape (M, 2)

    @property
    def square(self) -> float:
        return float(self.residual_m @ self.residual_m)


@dataclass(frozen=True, slots=True)
class _Task:
    """Input of a fit: steps of the command, measured positions, number of stages."""

    at_s: Array  # of each step. Shape (K,)
    steps_m: Array
    measured_s: Array
    measured_m: Array
    stages: int

    def at(self, delay_s: float, lag_s: float) -> _Point:
        """Return residuals and Jacobian at a delay and a lag."""
        n = self.stages
        age_s = np.maximum(self.measured_s[:, None] - delay_s - self.at_s[None, :], 0.0)
        x = n / lag_s * age_s
        decay = np.exp(-x)
        model_m = (1.0 - decay * sum(x**j / factorial(j) for j in range(n))) @ self.steps_m
        density = np.where(age_s > 0.0, n / lag_s * x ** (n - 1) / factorial(n - 1) * decay, 0.0)
        lag_slope = (density * age_s / lag_s) @ self.steps_m
        slopes = -np.stack((density @ self.steps_m, lag_slope), axis=1)
        residual_m = self.measured_m - model_m
        return _Point(delay_s, lag_s, residual_m - residual_m.mean(), slopes - slopes.mean(axis=0))


def identify_servo(steps: Steps) -> tuple[Fit, ...]:
    """Return the fitted delay and lag for each of STAGES.

    Raises DataError when the records do not determine them.
    """
    if min(len(steps.commanded_s), len(steps.measured_s)) < LEAST_SAMPLES:
        raise DataError("too few commands and poses received: check the load of this machine")
    travel_m = np.ptp(steps.commanded_m)
    if travel_m < LEAST_TRAVEL_M or np.ptp(steps.measured_m) < 0.3 * travel_m:
        raise DataError("the arm did not execute the small steps that were commanded")
    useful = steps.measured_s > steps.commanded_s[0]
    measured_s, measured_m = steps.measured_s[useful], steps.measured_m[useful]
    steps_m = np.diff(steps.commanded_m)
    moves = np.abs(steps_m) > LEAST_STEP_M
    sum_s = _start_sum_s(steps, measured_s, measured_m)
    at_s, steps_m = steps.commanded_s[1:][moves], steps_m[moves]
    fits = tuple(_fit(_Task(at_s, steps_m, measured_s, measured_m, n), sum_s) for n in STAGES)
    best = min(fits, key=lambda fit: fit.residual_std_m)
    share = best.residual_std_m / float(np.std(measured_m))
    if share > WORST_FIT:
        text = f"residual {100.0 * share:.0f} %, limit {100.0 * WORST_FIT:.0f} %"
        raise DataError(f"the measured motion does not match the commanded one: {text}")
    if best.sum_s > LONGEST_DELAY_S:
        raise DataError(f"the arm follows its commands later than {1e3 * LONGEST_DELAY_S:.0f} ms")
    return fits


def _fit(task: _Task, sum_s: float) -> Fit:
    """Return the best of the searches that start from a sum of delay and lag."""
    ends = [_least_squares_search(task, *start) for start in _start_splits(sum_s)]
    end = min(ends, key=lambda point: point.square)
    fixed_lag = [
        _least_squares_search(task, *start, fit_lag=False)
        for start in _start_splits(end.delay_s + end.lag_s)
    ]
    points = ends + fixed_lag
    best = min(points, key=lambda point: point.square)
    count, square = len(best.residual_m), max(best.square, LEAST_RESIDUAL_M**2)
    correlation = float(
        np.clip(best.residual_m[1:] @ best.residual_m[:-1] / square, 0.0, MOST_CORRELATION)
    )
    samples = count * (1.0 - correlation) / (1.0 + correlation)
    variance = square / (count - 3) * count / samples
    covariance = np.linalg.pinv(best.slopes.T @ best.slopes) * variance
    z_scores = [sqrt((point.square - best.square) / variance) for point in points]
    return Fit(
        stages=task.stages,
        delay_s=best.delay_s,
        lag_s=best.lag_s,
        residual_std_m=sqrt(square / count),
        sum_deviation_s=_standard_deviation(
            [point.delay_s + point.lag_s for point in points], covariance.sum(), z_scores
        ),
        lag_deviation_s=_standard_deviation(
            [point.lag_s for point in points], covariance[1, 1], z_scores
        ),
    )


def _standard_deviation(found_s: list[float], local: float, z_scores: list[float]) -> float:
    """Return the standard deviation of a parameter, from the local slopes and other minima.

    With few poses, or poses in phase with the commands, several delays and lags fit nearly
    equally well, and the local covariance covers the best one only. So the other results of the
    search are used too, and lags of all sizes with their best delays. A point that fits worse by z
    deviations (likelihood ratio) at a distance w contributes w / z; with a single minimum this
    adds nothing to the local covariance.

    Args:
        found_s: Value of the parameter at each point [s].
        local: Its variance by the slopes at the best point [s^2].
        z_scores: Deviations by which each point fits worse than the best one, which has 0.
    """
    best_s = found_s[z_scores.index(0.0)]
    distances_s = [abs(each_s - best_s) for each_s in found_s]
    alternatives_s = [w / max(1.0, z) for w, z in zip(distances_s, z_scores, strict=True)]
    return max(sqrt(max(float(local), 0.0)), *alternatives_s)


def _start_splits(sum_s: float) -> list[tuple[float, float]]:
    """Return start values: splits of one sum into delay and lag."""
    return [((1.0 - share) * sum_s, share * sum_s) for share in START_SHARES]


def _least_squares_search(
    task: _Task, delay_s: float, lag_s: float, *, fit_lag: bool = True
) -> _Point:
    """Return the least squares minimum (Levenberg-Marquardt); lag_too=False keeps the lag."""
    point, damping = task.at(delay_s, max(lag_s, SHORTEST_LAG_S)), 1e-3
    moves = np.array([1.0, float(fit_lag)])
    for _ in range(SEARCHES):
        slopes = point.slopes * moves
        normal = slopes.T @ slopes
        normal = normal + np.diag(damping * normal.diagonal() + 1e-12)
        step_s = np.linalg.solve(normal, slopes.T @ point.residual_m)
        candidate = task.at(
            point.delay_s + float(step_s[0]),  # may be negative: the sum stays correct
            max(point.lag_s + float(step_s[1]), SHORTEST_LAG_S),
        )
        if candidate.square < point.square:
            point, damping = candidate, 0.2 * damping
        else:
            damping *= 5.0
        if np.abs(step_s).max() < CONVERGED_S:
            break
    return point


def _start_sum_s(steps: Steps, measured_s: Array, measured_m: Array) -> float:
    """Return the time shift of the command that matches the measured motion best [s]."""
    shifts_s = np.arange(START_STEP_S, LONGEST_DELAY_S, START_STEP_S)
    deviations_m = [
        float(
            np.std(
                np.interp(measured_s - shift_s, steps.commanded_s, steps.commanded_m) - measured_m
            )
        )
        for shift_s in shifts_s
    ]
    return float(shifts_s[np.argmin(deviations_m)])
