"""How hot the adaptive loop may be: an arm that brakes slowly lifts off when it was too fast. Pure.

What an arm can brake is its acceleration limit over its speed limit in force feedback [1/s]. A loop
of gain k Ki = c / tau wants that much of it; below, the arm goes on while the law believes that it
stops. Both ends were found by experiment: the demo's cell, and the benchmark's.
"""

from dataclasses import dataclass

import numpy as np

from common.cell import Cell

BRAKES_1_S = (40.0, 66.0)  # slowly, and well
LOOP = (2.0, 3.4)
FORESEEN_LOOP = (2.0, 2.5)
MOST_FORESEEN = (1.0, 0.9)


@dataclass(frozen=True, slots=True)
class Heat:
    """Of a loop with prediction."""

    loop: float  # k Ki tau at most
    foreseen_loop: float  # from this k Ki tau on as much as possible is foreseen
    most_foreseen: float  # of what is on its way


def heat_of(cell: Cell) -> Heat:
    """Return what the arm of a cell bears."""
    brakes_1_s = cell.limits.accel_m_s2 / min(cell.force.speed_max_m_s, cell.limits.speed_m_s)
    rows = (LOOP, FORESEEN_LOOP, MOST_FORESEEN)
    return Heat(*(float(np.interp(brakes_1_s, BRAKES_1_S, row)) for row in rows))
