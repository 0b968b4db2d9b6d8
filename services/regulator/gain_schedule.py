"""Gain limits of the adaptive loop, and a speed profile that the arm can brake from. Pure.

The loop gain is k Ki = c / tau. c is scheduled on `rates.robot_hz`: a controller that reports
rarely also executes poses rarely, each with its own delay, and deviates more from the delay model.

The predictor requires that commands are executed unchanged, so the law accelerates no faster than
the arm may. The arm brakes with a at most. For large errors the speed therefore follows the square
root of the error, as in proximate time-optimal servo control: the arm comes to rest just as the
force reaches its set point. Where the linear law

    v = Ki e,   dv/dt = -k Ki v

needs no more than a, at errors up to e_1 = a / (k Ki^2), it is used as it is; beyond,

    v = sqrt(2 a (e - e_1 / 2) / k)

which joins it with equal value and slope.
"""

from dataclasses import dataclass

import numpy as np

from common.config.cell import CellConfig
from common.motion.frames import Array, length

ROBOT_PERIODS_S = (0.010, 0.025)
LOOP = (3.4, 2.0)
FULL_PREDICTION_LOOP = (2.5, 2.0)
LARGEST_PREDICTION_WEIGHT = (0.9, 1.0)
ACCEL_SHARE = 0.95  # of the cell's limit: the arbiter must not have to limit the command
BRAKE_SHARE = 0.8  # of the cell's limit: the rest is margin for disturbances
LEAST_GAIN_M_PER_NS = 1e-9  # a request may set the gain to zero
LEAST_ERROR_N, LEAST_SHARE = 1e-9, 0.1  # least share of the braking per axis


@dataclass(frozen=True, slots=True)
class GainLimits:
    """Limits of a loop with prediction."""

    loop: float  # k Ki tau at most
    full_prediction_loop: float  # k Ki tau from which the prediction has its full weight
    largest_prediction_weight: float  # largest weight of the prediction
    accel_m_s2: float
    brake_m_s2: float


def gain_limits_of(cell: CellConfig) -> GainLimits:
    """Return the gain limits of a cell."""
    period_s = 1.0 / cell.rates.robot_hz
    rows = (LOOP, FULL_PREDICTION_LOOP, LARGEST_PREDICTION_WEIGHT)
    loop, full_prediction_loop, largest_weight = (
        float(np.interp(period_s, ROBOT_PERIODS_S, row)) for row in rows
    )
    accel_m_s2 = cell.limits.accel_m_s2
    return GainLimits(
        loop,
        full_prediction_loop,
        largest_weight,
        ACCEL_SHARE * accel_m_s2,
        BRAKE_SHARE * accel_m_s2,
    )


def limit_gain_for_braking(Ki: Array, error_N: Array, k: Array, brake_m_s2: float) -> Array:
    """Return the gain along each axis with which the arm still comes to rest in time.

    Axes share the deceleration in proportion to their errors.

    Args:
        Ki: Integral gain of the linear law [m/(N s)]. Shape (3,), as the others.
        error_N: Predicted force minus the set point.
        k: Stiffness [N/m].
        brake_m_s2: Deceleration of the arm.
    """
    size_N = max(length(error_N), LEAST_ERROR_N)
    brakes_m_s2 = brake_m_s2 * np.maximum(np.abs(error_N) / size_N, LEAST_SHARE)
    linear_N = brakes_m_s2 / (k * np.maximum(Ki, LEAST_GAIN_M_PER_NS) ** 2)
    error = np.maximum(np.abs(error_N), linear_N)
    speed_m_s = np.sqrt(2.0 * brakes_m_s2 * (error - 0.5 * linear_N) / k)
    return np.asarray(np.minimum(Ki, speed_m_s / error))
