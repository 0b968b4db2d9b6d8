"""Response of the force to the law's own commands, reduced by the arm's compliance. Pure.

The measured pose gives the contact stiffness. Seen from the command, the servos are a spring in
series with it, and the force responds less. Recursive least squares with exponential forgetting
fits, along each axis,

    F = F_0 - k x + r v      x: the command passed through the delay model, v: its speed

so an error of the assumed delay goes into r, not into k. The result is a share of the stiffness of
the measured pose, between the share that the softest arm leaves and one. An arm that does not
follow its commands can therefore never make the contact look soft.
"""

from dataclasses import dataclass, replace
from math import exp

import numpy as np

from common.motion.frames import Array

MARGIN, SIGMAS = 1.03, 2.0  # an estimate too stiff is slow, one too soft overshoots
SURE_SHARE = 0.03  # largest sigma of an accepted estimate, relative to k
SOFTEST_ARM_N_M = 2.5e5
LEARN_S = 0.015
FEW_RESPONSES = 8.0  # least weighted number of samples
PARALLEL_N = 1e-6  # collinear travel and speed: limit relative to the product of their squares


@dataclass(frozen=True, slots=True)
class ResponseSample:
    """One sample along the tool's axes, of shape (3,) each, with its noise levels."""

    way_m: Array
    speed_m_s: Array
    force_N: Array
    dt_s: float
    memory_s: float
    noise_N: float  # standard deviation of a filtered reading
    least_way_m: float  # least excitation: standard deviation of the travel over the memory


@dataclass(frozen=True, slots=True)
class Response:
    """Weighted means and centred sums of (travel, speed, force), and the estimate."""

    share: Array  # of the stiffness of the measured pose. Shape (3,)
    weight: float
    mean: Array  # shape (3, 3): last index the axis, as in `sums`
    sums: Array  # of products of two of them. Shape (3, 3, 3)


def unheard() -> Response:
    """Return the initial state: a rigid arm."""
    return Response(np.ones(3), 0.0, np.zeros((3, 3)), np.zeros((3, 3, 3)))


def hear(state: Response, answer: ResponseSample, k: Array) -> Response:
    """Return the state after one more sample in contact; k of the measured pose, shape (3,)."""
    kept = exp(-answer.dt_s / answer.memory_s)
    weight = kept * state.weight + 1.0
    off = np.stack((answer.way_m, answer.speed_m_s, answer.force_N)) - state.mean
    part = kept * state.weight / weight
    sums = kept * state.sums + part * off[:, None, :] * off[None, :, :]
    now = Response(state.share, weight, state.mean + off / weight, sums)
    return now if weight < FEW_RESPONSES else replace(now, share=_believed(now, answer, k))


def _believed(now: Response, answer: ResponseSample, k: Array) -> Array:
    ways, both, speeds = now.sums[0, 0], now.sums[0, 1], now.sums[1, 1]
    by_way, by_speed = now.sums[0, 2], now.sums[1, 2]
    square = ways * speeds - both**2
    tells = (ways > now.weight * answer.least_way_m**2) & (square > PARALLEL_N * ways * speeds)
    square = np.where(tells, square, 1.0)
    slope = (by_speed * both - by_way * speeds) / square
    rate = (by_speed * ways - by_way * both) / square
    rest = np.maximum(now.sums[2, 2] + slope * by_way - rate * by_speed, 0.0) / now.weight
    sigma = np.sqrt((rest + answer.noise_N**2) * speeds / square)
    found = np.clip((MARGIN * slope + SIGMAS * sigma) / k, 1.0 / (1.0 + k / SOFTEST_ARM_N_M), 1.0)
    sure = tells & (sigma < SURE_SHARE * slope)
    learnt = 1.0 - exp(-answer.dt_s / LEARN_S)
    return np.where(sure, now.share + learnt * (found - now.share), now.share)
