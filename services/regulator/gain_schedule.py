"""How hot the adaptive loop may be, and how fast it may go where it has to brake. Pure.

The loop's gain is k Ki = c / tau. c falls with `rates.robot_hz`: a controller that reports rarely
takes poses rarely, each after a time of its own, and is not where the model of its way has it.

The law foresees what its own commands will do, so they must be carried out as they are: it speeds
up no faster than the arm may. An arm brakes with a at most. While the error is large the speed
therefore follows its root: from there the arm comes to rest just as the force has reached its set
point. Where the linear law

    v = Ki e,   dv/dt = -k Ki v

asks for no more than a, at errors up to e_1 = a / (k Ki^2), it is linear; beyond,

    v = sqrt(2 a (e - e_1 / 2) / k)

which joins it without a step or a kink.
"""

from dataclasses import dataclass

import numpy as np

from common.config.cell import Cell
from common.motion.frames import Array, length

ROBOT_PERIODS_S = (0.010, 0.025)
LOOP = (3.4, 2.0)
FORESEEN_LOOP = (2.5, 2.0)
MOST_FORESEEN = (0.9, 1.0)
ACCEL_SHARE = 0.95  # of the cell's limit: the arbiter shall have nothing to take away
BRAKE_SHARE = 0.8  # the same: what is left is for what was not foreseen
LEAST_GAIN_M_PER_NS = 1e-9  # a person may set zero
LEAST_ERROR_N, LEAST_SHARE = 1e-9, 0.1  # of the braking, for an axis that is almost there


@dataclass(frozen=True, slots=True)
class Heat:
    """Of a loop with prediction."""

    loop: float  # k Ki tau at most
    foreseen_loop: float  # from this k Ki tau on as much as possible is foreseen
    most_foreseen: float  # of what is on its way
    accel_m_s2: float
    brake_m_s2: float


def heat_of(cell: Cell) -> Heat:
    """Return what the arm of a cell bears."""
    period_s = 1.0 / cell.rates.robot_hz
    rows = (LOOP, FORESEEN_LOOP, MOST_FORESEEN)
    loop, foreseen_loop, most = (float(np.interp(period_s, ROBOT_PERIODS_S, row)) for row in rows)
    accel_m_s2 = cell.limits.accel_m_s2
    return Heat(loop, foreseen_loop, most, ACCEL_SHARE * accel_m_s2, BRAKE_SHARE * accel_m_s2)


def braked(Ki: Array, error_N: Array, k: Array, brake_m_s2: float) -> Array:
    """Return the gain along each axis with which the arm still comes to rest in time.

    Axes that brake together share what there is as their errors do.

    Args:
        Ki: Integral gain of the linear law [m/(N s)]. Shape (3,), as the others.
        error_N: Foreseen force less the set point.
        k: Stiffness [N/m].
        brake_m_s2: What the arm brakes with.
    """
    size_N = max(length(error_N), LEAST_ERROR_N)
    brakes_m_s2 = brake_m_s2 * np.maximum(np.abs(error_N) / size_N, LEAST_SHARE)
    linear_N = brakes_m_s2 / (k * np.maximum(Ki, LEAST_GAIN_M_PER_NS) ** 2)
    error = np.maximum(np.abs(error_N), linear_N)
    speed_m_s = np.sqrt(2.0 * brakes_m_s2 * (error - 0.5 * linear_N) / k)
    return np.asarray(np.minimum(Ki, speed_m_s / error))
