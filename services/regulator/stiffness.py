"""Contact stiffness estimator along three axes: an upper confidence bound. Pure.

Recursive least squares with exponential forgetting fits the slope of force over travel. The
estimate is the bound

    k = 1.08 slope + 3.5 sigma(slope)

because an estimate too stiff is slow and one too soft overshoots. It starts at the stiffest contact
of the cell, falls as fast as the data permit, and is kept without excitation. It rises only while
1.08 slope is above it: a bound that is high for lack of data carries no information, and would
drive the estimate up while the tool is nearly at rest.
"""

from dataclasses import dataclass, replace
from math import exp

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array

Flags = npt.NDArray[np.bool_]

SLOPE_MARGIN = 1.08
BOUND_SIGMAS = 3.5
SURE = 0.3  # 3.5 sigma below this share of the slope: the fit may raise the estimate as well
EXPLAINED = 0.9  # share of the force's variance explained by travel: the tool's own motion
DOWN_S = 0.002  # time constant towards a lower bound
UP_S = 0.002
FEW_SAMPLES = 5.0  # least weighted number of samples
FITTED = 2.0  # degrees of freedom of the fitted line


@dataclass(frozen=True, slots=True)
class StiffnessSettings:
    """Bounds, memory and noise of the estimator."""

    stiffest: float  # N/m or N m/rad
    softest: float
    memory_s: float
    noise: float  # standard deviation of one filtered reading, N or N m
    least_travel: float  # least excitation: standard deviation of travel over the memory, m or rad


@dataclass(frozen=True, slots=True)
class Stiffness:
    """Weighted sums of the recent samples, and the estimate. Each of shape (3,)."""

    k: Array
    weight: float
    travel: Array  # means
    force: Array
    travel_squares: Array  # centred sums of squares and products
    products: Array
    force_squares: Array
    identified: Flags  # whether k is identified, not only bounded; of bool


def stiffest(settings: StiffnessSettings) -> Stiffness:
    """Return the initial state: the stiffest contact, not identified."""
    return replace(initial(np.full(3, settings.stiffest)), identified=np.zeros(3, dtype=bool))


def initial(k: Array) -> Stiffness:
    """Return the initial state from a stiffness identified before. Shape (3,)."""
    zero = np.zeros(3)
    return Stiffness(
        np.array(k, dtype=float), 0.0, zero, zero, zero, zero, zero, np.ones(3, dtype=bool)
    )


def update(
    state: Stiffness,
    travel: Array,
    force: Array,
    *,
    dt_s: float,
    settings: StiffnessSettings,
    may_soften: bool = True,
) -> Stiffness:
    """Return the estimate after one more sample in contact.

    Args:
        state: Estimate so far.
        travel: Travel along each axis, filtered as the force is [m or rad]. Shape (3,).
        force: Of the environment on the tool along each axis [N or N m]. Shape (3,).
        dt_s: Time since the last sample.
        settings: Bounds.
        may_soften: Whether the law caused the travel. While a moving surface is tracked, travel
            without force carries no stiffness information.
    """
    forgetting = exp(-dt_s / settings.memory_s)
    weight = forgetting * state.weight + 1.0
    d_travel, d_force = travel - state.travel, force - state.force
    share = forgetting * state.weight / weight
    now = Stiffness(
        k=state.k,
        weight=weight,
        travel=state.travel + d_travel / weight,
        force=state.force + d_force / weight,
        travel_squares=forgetting * state.travel_squares + share * d_travel * d_travel,
        products=forgetting * state.products + share * d_travel * d_force,
        force_squares=forgetting * state.force_squares + share * d_force * d_force,
        identified=state.identified,
    )
    return _estimate(now, dt_s, settings, may_soften=may_soften)


def _estimate(
    now: Stiffness, dt_s: float, settings: StiffnessSettings, *, may_soften: bool
) -> Stiffness:
    moved = now.travel_squares > now.weight * settings.least_travel**2
    travel_squares = np.where(moved, now.travel_squares, 1.0)
    slope = -now.products / travel_squares
    spare = max(now.weight - FITTED, 1.0)
    variance = (
        np.maximum(now.force_squares - now.products**2 / travel_squares, 0.0) / spare
        + settings.noise**2
    )
    sigma = np.sqrt(variance / travel_squares)
    bound = np.maximum(SLOPE_MARGIN * slope + BOUND_SIGMAS * sigma, settings.softest)
    bound = np.minimum(bound, settings.stiffest)
    useful = moved & (slope > 0.0) & (now.weight > FEW_SAMPLES)
    sure = useful & (BOUND_SIGMAS * sigma < SURE * slope)
    explained = sure & (now.products**2 > EXPLAINED * now.travel_squares * now.force_squares)
    lower = useful & (bound < now.k) & (may_soften | explained)
    least = np.minimum(SLOPE_MARGIN * slope, settings.stiffest)
    higher = sure & (least > now.k)
    down, up = 1.0 - exp(-dt_s / DOWN_S), 1.0 - exp(-dt_s / UP_S)
    k = now.k + np.where(lower, down * (bound - now.k), 0.0)
    k = k + np.where(higher, up * (least - now.k), 0.0)
    return replace(now, k=k, identified=now.identified | sure)
