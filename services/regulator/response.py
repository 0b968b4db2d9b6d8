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

    travel_m: Array
    speed_m_s: Array
    force_N: Array
    dt_s: float
    memory_s: float
    noise_N: float  # standard deviation of a filtered reading
    least_travel_m: float  # least excitation: standard deviation of the travel over the memory


@dataclass(frozen=True, slots=True)
class Response:
    """Weighted means and centred sums of (travel, speed, force), and the estimate."""

    share: Array  # of the stiffness of the measured pose. Shape (3,)
    weight: float
    mean: Array  # shape (3, 3): last index the axis, as in `sums`
    sums: Array  # of products of two of them. Shape (3, 3, 3)


def initial() -> Response:
    """Return the initial state: a rigid arm."""
    return Response(np.ones(3), 0.0, np.zeros((3, 3)), np.zeros((3, 3, 3)))


def update(state: Response, sample: ResponseSample, k: Array) -> Response:
    """Return the state after one more sample in contact; k of the measured pose, shape (3,)."""
    forgetting = exp(-sample.dt_s / sample.memory_s)
    weight = forgetting * state.weight + 1.0
    off = np.stack((sample.travel_m, sample.speed_m_s, sample.force_N)) - state.mean
    part = forgetting * state.weight / weight
    sums = forgetting * state.sums + part * off[:, None, :] * off[None, :, :]
    now = Response(state.share, weight, state.mean + off / weight, sums)
    return now if weight < FEW_RESPONSES else replace(now, share=_estimate(now, sample, k))


def _estimate(now: Response, sample: ResponseSample, k: Array) -> Array:
    travel_squares, products, speed_squares = now.sums[0, 0], now.sums[0, 1], now.sums[1, 1]
    travel_force, speed_force = now.sums[0, 2], now.sums[1, 2]
    square = travel_squares * speed_squares - products**2
    is_informative = (travel_squares > now.weight * sample.least_travel_m**2) & (
        square > PARALLEL_N * travel_squares * speed_squares
    )
    square = np.where(is_informative, square, 1.0)
    slope = (speed_force * products - travel_force * speed_squares) / square
    rate = (speed_force * travel_squares - travel_force * products) / square
    variance = (
        np.maximum(now.sums[2, 2] + slope * travel_force - rate * speed_force, 0.0) / now.weight
    )
    sigma = np.sqrt((variance + sample.noise_N**2) * speed_squares / square)
    estimated = np.clip(
        (MARGIN * slope + SIGMAS * sigma) / k, 1.0 / (1.0 + k / SOFTEST_ARM_N_M), 1.0
    )
    sure = is_informative & (sigma < SURE_SHARE * slope)
    gain = 1.0 - exp(-sample.dt_s / LEARN_S)
    return np.where(sure, now.share + gain * (estimated - now.share), now.share)
