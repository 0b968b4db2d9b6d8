"""How stiff is what the tool touches, along three axes: an upper bound that follows the data. Pure.

The slope of force over way is estimated by least squares that forget, and

    k = 1.08 slope + 3.5 sigma(slope)

is believed: too stiff is slow, too soft overshoots. It begins with the stiffest contact that the
cell allows for, comes down as fast as the data permit, and is kept while they say nothing new. It
rises only where 1.08 slope is above it: a bound that is above for want of data says nothing, and
would drive it up while the tool stands nearly still.
"""

from dataclasses import dataclass, replace
from math import exp

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array

Flags = npt.NDArray[np.bool_]

SLOPE_MARGIN = 1.08
SIGMAS = 3.5
SURE = 0.3  # 3.5 sigma below this part of the slope: it may raise the estimate as well
EXPLAINED = 0.9  # of the force by the way: the way is the tool's own, whatever else moves
DOWN_S = 0.002  # of approaching a lower bound
UP_S = 0.002
FEW = 5.0  # weighted samples below which nothing is concluded
FITTED = 2.0  # of them are used up by the line's two numbers: a slow loop has few to spare


@dataclass(frozen=True, slots=True)
class StiffnessSettings:
    """What bounds the estimate."""

    stiffest: float  # N/m or N m/rad
    softest: float
    memory_s: float
    noise: float  # standard deviation of one filtered reading, N or N m
    way: float  # smaller movements tell nothing: standard deviation over the memory, m or rad


@dataclass(frozen=True, slots=True)
class Stiffness:
    """Weighted sums of the recent samples, and what is believed. Each of shape (3,)."""

    k: Array
    weight: float
    way: Array  # means
    force: Array
    ways: Array  # centred sums of squares and products
    both: Array
    forces: Array
    known: Flags  # whether the data have pinned it down, not only bounded it; of bool


def stiffest(settings: StiffnessSettings) -> Stiffness:
    """Return the state before anything was felt."""
    return replace(believing(np.full(3, settings.stiffest)), known=np.zeros(3, dtype=bool))


def believing(k: Array) -> Stiffness:
    """Return the state that starts from a stiffness that was met before. Shape (3,)."""
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
    """Return the estimate after one more sample taken in contact.

    Args:
        state: Estimate so far.
        way: Where the tool is along each axis, filtered as the force is [m or rad]. Shape (3,).
        force: Of the environment on the tool along each axis [N or N m]. Shape (3,).
        dt_s: Time since the last sample.
        settings: Bounds.
        may_soften: Whether the way is the law's own doing. Where the tool follows a surface that
            moves, way without force says nothing about stiffness.
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
    bound = np.maximum(SLOPE_MARGIN * slope + SIGMAS * sigma, settings.softest)
    bound = np.minimum(bound, settings.stiffest)
    useful = moved & (slope > 0.0) & (now.weight > FEW)
    sure = useful & (SIGMAS * sigma < SURE * slope)
    explained = sure & (now.both**2 > EXPLAINED * now.ways * now.forces)
    lower = useful & (bound < now.k) & (may_soften | explained)
    least = np.minimum(SLOPE_MARGIN * slope, settings.stiffest)
    higher = sure & (least > now.k)
    down, up = 1.0 - exp(-dt_s / DOWN_S), 1.0 - exp(-dt_s / UP_S)
    k = now.k + np.where(lower, down * (bound - now.k), 0.0)
    k = k + np.where(higher, up * (least - now.k), 0.0)
    return replace(now, k=k, known=now.known | sure)
