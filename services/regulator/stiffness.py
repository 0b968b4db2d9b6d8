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
    way: float  # least excitation: standard deviation of travel over the memory, m or rad


@dataclass(frozen=True, slots=True)
class Stiffness:
    """Weighted sums of the recent samples, and the estimate. Each of shape (3,)."""

    k: Array
    weight: float
    way: Array  # means
    force: Array
    ways: Array  # centred sums of squares and products
    both: Array
    forces: Array
    known: Flags  # whether k is identified, not only bounded; of bool


def stiffest(settings: StiffnessSettings) -> Stiffness:
    """Return the initial state: the stiffest contact, not identified."""
    return replace(believing(np.full(3, settings.stiffest)), known=np.zeros(3, dtype=bool))


def believing(k: Array) -> Stiffness:
    """Return the initial state from a stiffness identified before. Shape (3,)."""
    zero = np.zeros(3)
    return Stiffness(
        np.array(k, dtype=float), 0.0, zero, zero, zero, zero, zero, np.ones(3, dtype=bool)
    )


def feel(
    state: Stiffness,
    way: Array,
    force: Array,
    *,
    dt_s: float,
    settings: StiffnessSettings,
    may_soften: bool = True,
) -> Stiffness:
    """Return the estimate after one more sample in contact.

    Args:
        state: Estimate so far.
        way: Travel along each axis, filtered as the force is [m or rad]. Shape (3,).
        force: Of the environment on the tool along each axis [N or N m]. Shape (3,).
        dt_s: Time since the last sample.
        settings: Bounds.
        may_soften: Whether the law caused the travel. While a moving surface is tracked, travel
            without force carries no stiffness information.
    """
    kept = exp(-dt_s / settings.memory_s)
    weight = kept * state.weight + 1.0
    d_way, d_force = way - state.way, force - state.force
    share = kept * state.weight / weight
    now = Stiffness(
        k=state.k,
        weight=weight,
        way=state.way + d_way / weight,
        force=state.force + d_force / weight,
        ways=kept * state.ways + share * d_way * d_way,
        both=kept * state.both + share * d_way * d_force,
        forces=kept * state.forces + share * d_force * d_force,
        known=state.known,
    )
    return _believed(now, dt_s, settings, may_soften=may_soften)


def _believed(
    now: Stiffness, dt_s: float, settings: StiffnessSettings, *, may_soften: bool
) -> Stiffness:
    moved = now.ways > now.weight * settings.way**2
    ways = np.where(moved, now.ways, 1.0)
    slope = -now.both / ways
    spare = max(now.weight - FITTED, 1.0)
    rest = np.maximum(now.forces - now.both**2 / ways, 0.0) / spare + settings.noise**2
    sigma = np.sqrt(rest / ways)
    bound = np.maximum(SLOPE_MARGIN * slope + BOUND_SIGMAS * sigma, settings.softest)
    bound = np.minimum(bound, settings.stiffest)
    useful = moved & (slope > 0.0) & (now.weight > FEW_SAMPLES)
    sure = useful & (BOUND_SIGMAS * sigma < SURE * slope)
    explained = sure & (now.both**2 > EXPLAINED * now.ways * now.forces)
    lower = useful & (bound < now.k) & (may_soften | explained)
    least = np.minimum(SLOPE_MARGIN * slope, settings.stiffest)
    higher = sure & (least > now.k)
    down, up = 1.0 - exp(-dt_s / DOWN_S), 1.0 - exp(-dt_s / UP_S)
    k = now.k + np.where(lower, down * (bound - now.k), 0.0)
    k = k + np.where(higher, up * (least - now.k), 0.0)
    return replace(now, k=k, known=now.known | sure)
