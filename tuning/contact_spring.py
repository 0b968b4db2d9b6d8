"""The stiffness of what the tool presses on, from places at rest. Pure."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from common.motion.frames import Array
from forcemesh.errors import DataError

LEAST_PLACES = 2
LEAST_FORCE_N = 1.0
SIGMAS = 2.0
REPEATS_SHARE = 0.05  # two deviations of a stiffness that repeats are no larger part of it
WORST_SHARE = 0.5  # beyond it nothing is known


@dataclass(frozen=True, slots=True)
class Spring:
    """The stiffness along the press axis."""

    k_N_m: float
    spread_N_m: float  # standard deviation

    @property
    def bound_N_m(self) -> float:
        """What gains should be safe for: two deviations more."""
        return self.k_N_m + SIGMAS * self.spread_N_m

    @property
    def repeats(self) -> bool:
        """Whether more presses would not make it much better."""
        return SIGMAS * self.spread_N_m <= REPEATS_SHARE * self.k_N_m

    @property
    def is_known(self) -> bool:
        """Whether the presses show a stiffness at all."""
        return SIGMAS * self.spread_N_m <= WORST_SHARE * self.k_N_m


def spring(ways_m: Array, forces_N: Array) -> Spring:
    """Return the stiffness from places at rest: way into the surface and force that pushes back.

    Args:
        ways_m: Deeper is larger. Shape (N,).
        forces_N: Along the tool's axis; the tool presses with it. Shape (N,).

    Raises:
        DataError: Too few places, or the force does not rise with the way.
    """
    if len(ways_m) < LEAST_PLACES or np.ptp(forces_N) < LEAST_FORCE_N:
        raise DataError("the press did not change the force enough to tell a stiffness")
    way, force = ways_m - np.mean(ways_m), forces_N - np.mean(forces_N)
    along = float(force @ force)
    compliance = float(way @ force) / along  # way has the noise of poses: it is what is regressed
    if compliance <= 0.0:
        raise DataError("the force does not rise with the way: does something move?")
    rest_m = way - compliance * force
    spread = sqrt(float(rest_m @ rest_m) / max(len(way) - 2, 1) / along)
    k = 1.0 / compliance
    return Spring(k, k * spread / compliance)
