"""Estimates of the adaptive law: contact stiffness, and the share of it that commands see. Pure.

Recursive least squares with exponential forgetting, along each axis of the tool. An estimate too
stiff is slow and one too soft overshoots, so both are upper bounds.

Stiffness: the slope of force over measured travel,

    k = 1.08 slope + 3.5 sigma(slope)

It starts at the stiffest contact of the cell, falls as fast as the data permit, and is kept without
excitation. It rises only while 1.08 slope is above it: a bound that is high for lack of data
carries no information, and would drive the estimate up while the tool is nearly at rest.

Share: the servos are a spring in series with the contact, and the force responds less to commands.

    F = F_0 - k x + r v      x: the command passed through the delay model, v: its speed

so an error of the assumed delay goes into r, not into k. The share is between that of the softest
arm and one: an arm that does not follow its commands can never make the contact look soft.
"""

from dataclasses import dataclass
from math import exp

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array

SOFTEST_CONTACT_N_M = 200.0
LEAST_TRAVEL_M = 1e-5  # least excitation: standard deviation of travel over the memory
SLOPE_MARGIN, BOUND_SIGMAS = 1.08, 3.5
SURE = 0.3  # 3.5 sigma below this share of the slope: the fit may raise the estimate as well
EXPLAINED = 0.9  # share of the force's variance explained by travel: the tool's own motion
FOLLOW_S = 0.002  # time constant of the stiffness
FEW_SAMPLES = 5.0  # least weighted number of samples
FITTED = 2.0  # degrees of freedom of the fitted line

SHARE_MARGIN, SHARE_SIGMAS = 1.03, 2.0
SURE_SHARE = 0.03  # largest sigma of an accepted share, relative to k
SOFTEST_ARM_N_M = 2.5e5
LEARN_S = 0.015  # time constant of the share
FEW_RESPONSES = 8.0
PARALLEL_N = 1e-6  # collinear travel and speed: limit relative to the product of their squares


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Upper bound, memory and noise of the estimates."""

    stiffest_N_m: float
    memory_s: float
    noise_N: float  # standard deviation of one filtered reading


@dataclass(frozen=True, slots=True)
class Moments:
    """Weighted means and centred sums of products of n quantities along three axes."""

    weight: float
    mean: Array  # shape (n, 3)
    sums: Array  # shape (n, n, 3)

    @classmethod
    def none(cls, n: int) -> "Moments":
        """Return the moments before the first sample."""
        return cls(0.0, np.zeros((n, 3)), np.zeros((n, n, 3)))

    def after(self, values: tuple[Array, ...], forgetting: float) -> "Moments":
        """Return the moments after one more sample of n values, each of shape (3,)."""
        weight = forgetting * self.weight + 1.0
        off = np.stack(values) - self.mean
        part = forgetting * self.weight / weight
        sums = forgetting * self.sums + part * off[:, None, :] * off[None, :, :]
        return Moments(weight, self.mean + off / weight, sums)


@dataclass(frozen=True, slots=True)
class Stiffness:
    """Stiffness of the contact, and the moments of travel and force."""

    k: Array  # shape (3,)
    identified: npt.NDArray[np.bool_]  # whether k is identified, not only bounded. Shape (3,)
    moments: Moments

    @classmethod
    def stiffest(cls, settings: FitSettings) -> "Stiffness":
        """Return the initial state: the stiffest contact, not identified."""
        return cls(np.full(3, settings.stiffest_N_m), np.zeros(3, dtype=bool), Moments.none(2))

    @classmethod
    def known(cls, k: Array) -> "Stiffness":
        """Return the initial state from a stiffness identified before. Shape (3,)."""
        return cls(np.array(k, dtype=float), np.ones(3, dtype=bool), Moments.none(2))

    def after(
        self,
        travel: Array,
        force: Array,
        *,
        dt_s: float,
        settings: FitSettings,
        may_soften: bool = True,
    ) -> "Stiffness":
        """Return the estimate after one more sample in contact.

        Args:
            travel: Measured travel along each axis, filtered as the force is [m]. Shape (3,).
            force: Of the environment on the tool along each axis [N]. Shape (3,).
            dt_s: Time since the last sample.
            settings: Bounds.
            may_soften: Whether the law caused the travel. While a moving surface is tracked, travel
                without force carries no stiffness information.
        """
        moments = self.moments.after((travel, force), exp(-dt_s / settings.memory_s))
        weight, sums = moments.weight, moments.sums
        moved = sums[0, 0] > weight * LEAST_TRAVEL_M**2
        travel_squares, products = np.where(moved, sums[0, 0], 1.0), sums[0, 1]
        slope = -products / travel_squares
        residual = np.maximum(sums[1, 1] - products**2 / travel_squares, 0.0)
        variance = residual / max(weight - FITTED, 1.0) + settings.noise_N**2
        sigma = np.sqrt(variance / travel_squares)
        bound = np.maximum(SLOPE_MARGIN * slope + BOUND_SIGMAS * sigma, SOFTEST_CONTACT_N_M)
        bound = np.minimum(bound, settings.stiffest_N_m)
        useful = moved & (slope > 0.0) & (weight > FEW_SAMPLES)
        sure = useful & (BOUND_SIGMAS * sigma < SURE * slope)
        explained = sure & (products**2 > EXPLAINED * sums[0, 0] * sums[1, 1])
        lower = useful & (bound < self.k) & (may_soften | explained)
        least = np.minimum(SLOPE_MARGIN * slope, settings.stiffest_N_m)
        higher = sure & (least > self.k)
        gain = 1.0 - exp(-dt_s / FOLLOW_S)
        k = self.k + np.where(lower, gain * (bound - self.k), 0.0)
        k = k + np.where(higher, gain * (least - self.k), 0.0)
        return Stiffness(k, self.identified | sure, moments)


@dataclass(frozen=True, slots=True)
class ResponseShare:
    """Share of the stiffness that commands see, and the moments of travel, speed and force."""

    share: Array  # shape (3,)
    moments: Moments

    @classmethod
    def rigid(cls) -> "ResponseShare":
        """Return the initial state: a rigid arm."""
        return cls(np.ones(3), Moments.none(3))

    def after(
        self, values: tuple[Array, Array, Array], k: Array, *, dt_s: float, settings: FitSettings
    ) -> "ResponseShare":
        """Return the estimate after one more sample in contact.

        Args:
            values: Commanded travel, its speed, and the force along each axis. Shapes (3,).
            k: Stiffness of the measured pose. Shape (3,).
            dt_s: Time since the last sample.
            settings: Memory and noise.
        """
        moments = self.moments.after(values, exp(-dt_s / settings.memory_s))
        weight, sums = moments.weight, moments.sums
        if weight < FEW_RESPONSES:
            return ResponseShare(self.share, moments)
        travel_squares, products, speed_squares = sums[0, 0], sums[0, 1], sums[1, 1]
        travel_force, speed_force = sums[0, 2], sums[1, 2]
        square = travel_squares * speed_squares - products**2
        is_informative = (travel_squares > weight * LEAST_TRAVEL_M**2) & (
            square > PARALLEL_N * travel_squares * speed_squares
        )
        square = np.where(is_informative, square, 1.0)
        slope = (speed_force * products - travel_force * speed_squares) / square
        rate = (speed_force * travel_squares - travel_force * products) / square
        residual = np.maximum(sums[2, 2] + slope * travel_force - rate * speed_force, 0.0)
        variance = residual / weight + settings.noise_N**2
        sigma = np.sqrt(variance * speed_squares / square)
        softest = 1.0 / (1.0 + k / SOFTEST_ARM_N_M)
        estimated = np.clip((SHARE_MARGIN * slope + SHARE_SIGMAS * sigma) / k, softest, 1.0)
        sure = is_informative & (sigma < SURE_SHARE * slope)
        gain = 1.0 - exp(-dt_s / LEARN_S)
        share = np.where(sure, self.share + gain * (estimated - self.share), self.share)
        return ResponseShare(share, moments)
