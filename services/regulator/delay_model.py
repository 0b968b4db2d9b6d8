"""Where a command is on its way to the force: controller's delay, servo, wrench filter. Pure.

    command -> pure delay -> lag/2 -> lag/2 -> filter -> what the force of this moment belongs to

The half period of waiting between two commands needs no term: a command holds until the next one.
"""

from dataclasses import dataclass
from math import ceil, exp

import numpy as np

from common.config.cell import Cell
from common.motion.frames import Array

INSTANT_S = 1e-5  # a shorter lag is none
SUBSTEP_S = 0.001  # three stages in a row are exact enough in steps of a millisecond


@dataclass(frozen=True, slots=True)
class PathSettings:
    """The model of the way."""

    delay_s: float  # controller, processes, and the median of the wrench filter
    lag_s: float
    filter_s: float
    median_s: float  # of the delay

    @classmethod
    def of(cls, cell: Cell) -> "PathSettings":
        """Take them out of a cell file: together with half a period they are tau."""
        median_s = cell.filter_delay_s - cell.filter.lowpass_s
        delay_s = cell.robot.delay_s + cell.force.chain_s + median_s
        return cls(delay_s, cell.robot.lag_s, cell.filter.lowpass_s, median_s)


@dataclass(frozen=True, slots=True)
class Path:
    """Commands on their way. Each of shape (3,), one unit."""

    sent: tuple[tuple[float, Array], ...]  # since when [s], oldest first
    now_s: float
    first: Array  # after half the lag
    arm: Array  # after all of it: where the arm is
    felt: Array  # after the filter: what the filtered force belongs to
    speed: Array  # of `felt`, per second
    acceleration: Array  # of `felt`, per second squared

    @property
    def command(self) -> Array:
        """The newest command."""
        return self.sent[-1][1]


def at_rest(command: Array) -> Path:
    """Return a way on which one command has held for ever. Shape (3,)."""
    still = np.array(command, dtype=float)
    zero = np.zeros_like(still)
    return Path(((0.0, still),), 0.0, still, still, still, zero, zero)


def follow(path: Path, command: Array, dt_s: float, settings: PathSettings) -> Path:
    """Return the way after `command` has held for the last `dt_s` [s]. Shape (3,)."""
    sent = path.sent
    if not np.array_equal(command, path.command):
        sent = (*sent, (path.now_s, np.array(command, dtype=float)))
    steps = max(1, ceil(dt_s / SUBSTEP_S - 1e-9))
    step_s = dt_s / steps
    half_s, filter_s = 0.5 * settings.lag_s, settings.filter_s
    lagging, filtering = _share(step_s, half_s), _share(step_s, filter_s)
    first, arm, felt = path.first, path.arm, path.felt
    at = 0
    for number in range(steps):
        due_s = path.now_s + (number + 0.5) * step_s - settings.delay_s
        while at + 1 < len(sent) and sent[at + 1][0] <= due_s:
            at += 1
        first = first + lagging * (sent[at][1] - first)
        arm = arm + lagging * (first - arm)
        felt = felt + filtering * (arm - felt)
    speed, acceleration = (felt - path.felt) / dt_s, np.zeros_like(felt)
    if min(filter_s, half_s) > INSTANT_S:
        speed = (arm - felt) / filter_s
        acceleration = ((first - arm) / half_s - speed) / filter_s
    return Path(sent[at:], path.now_s + dt_s, first, arm, felt, speed, acceleration)


def _share(dt_s: float, lag_s: float) -> float:
    return 1.0 if lag_s <= INSTANT_S else 1.0 - exp(-dt_s / lag_s)
