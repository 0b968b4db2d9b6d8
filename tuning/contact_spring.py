"""Contact stiffness, by linear regression of penetration on force at rest. Pure."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from common.motion.frames import Array
from forcemesh.errors import DataError

LEAST_PLACES = 2
LEAST_SPRING_FORCE_N = 1.0
SIGMAS = 2.0
REPEATS_SHARE = 0.05  # largest relative uncertainty (two deviations) of a repeated stiffness
KNOWN_SHARE = 0.5  # relative uncertainty above which the stiffness is unknown


@dataclass(frozen=True, slots=True)
class Spring:
    """Stiffness along the press axis, with its standard deviation."""

    k_N_m: float
    spread_N_m: float  # standard deviation

    @property
    def bound_N_m(self) -> float:
        """Stiffness plus two standard deviations: the stiffness to design gains for."""
        return self.k_N_m + SIGMAS * self.spread_N_m

    @property
    def repeats(self) -> bool:
        """Whether more presses would hardly reduce the uncertainty."""
        return SIGMAS * self.spread_N_m <= REPEATS_SHARE * self.k_N_m

    @property
    def is_known(self) -> bool:
        """Whether the presses determine a stiffness."""
        return SIGMAS * self.spread_N_m <= KNOWN_SHARE * self.k_N_m


def fit_spring(travel_m: Array, forces_N: Array) -> Spring:
    """Return the stiffness from pairs of penetration and press force at rest.

    Args:
        travel_m: Penetration, larger is deeper. Shape (N,).
        forces_N: Press force along the tool's axis. Shape (N,).

    Raises:
        DataError: Too few points, or the force does not increase with the penetration.
    """
    if len(travel_m) < LEAST_PLACES or np.ptp(forces_N) < LEAST_SPRING_FORCE_N:
        raise DataError("the press did not change the force enough to identify a stiffness")
    travel, force = travel_m - np.mean(travel_m), forces_N - np.mean(forces_N)
    force_square = float(force @ force)
    compliance = (
        float(travel @ force) / force_square
    )  # the penetration is noisy: it is the regressand
    if compliance <= 0.0:
        raise DataError("the force does not increase with the penetration: does the surface move?")
    residual_m = travel - compliance * force
    spread = sqrt(float(residual_m @ residual_m) / max(len(travel) - 2, 1) / force_square)
    k = 1.0 / compliance
    return Spring(k, k * spread / compliance)
