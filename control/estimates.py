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
from math import exp, sqrt

from common.motion.frames import Vector

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


class Moments:
    """Weighted means and centred sums of products of two quantities; advanced in place."""

    def __init__(self) -> None:
        """Start before the first sample."""
        self.weight = 0.0
        self._means = 0.0, 0.0
        self._sums = 0.0, 0.0, 0.0

    def add(self, x: float, y: float, forgetting: float) -> tuple[float, float, float]:
        """Add one more sample of both; return the sums of x x, x y and y y."""
        before = forgetting * self.weight
        weight = self.weight = before + 1.0
        (mean_x, mean_y), (xx, xy, yy), part = self._means, self._sums, before / weight
        u, v = x - mean_x, y - mean_y
        self._means = mean_x + u / weight, mean_y + v / weight
        xx, xy, yy = forgetting * xx, forgetting * xy, forgetting * yy
        self._sums = xx + part * u * u, xy + part * u * v, yy + part * v * v
        return self._sums


class Stiffness:
    """Stiffness of the contact along one axis, and the moments of travel and force."""

    def __init__(self, k_N_m: float, *, is_identified: bool) -> None:
        """Start at the stiffest contact, or at a stiffness identified before."""
        self.k_N_m = k_N_m
        self.is_identified = is_identified  # not only bounded
        self._moments = Moments()

    def update(
        self,
        travel_m: float,
        force_N: float,
        *,
        dt_s: float,
        settings: FitSettings,
        may_soften: bool = True,
    ) -> None:
        """Update the estimate by one more sample in contact.

        Args:
            travel_m: Measured travel along the axis, filtered as the force is.
            force_N: Of the environment on the tool along the axis.
            dt_s: Time since the last sample.
            settings: Bounds.
            may_soften: Whether the law caused the travel. While a moving surface is tracked, travel
                without force carries no stiffness information.
        """
        forgetting, moments = exp(-dt_s / settings.memory_s), self._moments
        travel_square, product, force_square = moments.add(travel_m, force_N, forgetting)
        weight = moments.weight
        moved = travel_square > weight * LEAST_TRAVEL_M**2
        if not (moved and product < 0.0 and weight > FEW_SAMPLES):
            return
        slope = -product / travel_square
        residual = max(force_square - product * product / travel_square, 0.0)
        variance = residual / max(weight - FITTED, 1.0) + settings.noise_N**2
        sigma = sqrt(variance / travel_square)
        bound = max(SLOPE_MARGIN * slope + BOUND_SIGMAS * sigma, SOFTEST_CONTACT_N_M)
        bound = min(bound, settings.stiffest_N_m)
        least = min(SLOPE_MARGIN * slope, settings.stiffest_N_m)
        is_sure = BOUND_SIGMAS * sigma < SURE * slope
        is_explained = is_sure and product * product > EXPLAINED * travel_square * force_square
        gain = 1.0 - exp(-dt_s / FOLLOW_S)
        if bound < self.k_N_m and (may_soften or is_explained):
            self.k_N_m += gain * (bound - self.k_N_m)
        elif is_sure and least > self.k_N_m:
            self.k_N_m += gain * (least - self.k_N_m)
        self.is_identified = self.is_identified or is_sure


class ResponseShare:
    """Share of the stiffness along one axis that commands see, at first that of a rigid arm.

    With the moments of travel, speed and force.
    """

    def __init__(self) -> None:
        """Start with a rigid arm."""
        self.share = 1.0
        self._travel_speed, self._travel_force, self._speed_force = (Moments() for _ in range(3))

    def update(self, values: Vector, k_N_m: float, *, dt_s: float, settings: FitSettings) -> None:
        """Update the estimate by one more sample in contact.

        Args:
            values: Commanded travel [m], its speed [m/s], and the force [N] along the axis.
            k_N_m: Stiffness of the measured pose.
            dt_s: Time since the last sample.
            settings: Memory and noise.
        """
        (travel_m, speed_m_s, force_N), forgetting = values, exp(-dt_s / settings.memory_s)
        travel_square, product, speed_square = self._travel_speed.add(
            travel_m, speed_m_s, forgetting
        )
        _, travel_force, force_square = self._travel_force.add(travel_m, force_N, forgetting)
        _, speed_force, _ = self._speed_force.add(speed_m_s, force_N, forgetting)
        weight = self._travel_speed.weight
        square = travel_square * speed_square - product * product
        moved = travel_square > weight * LEAST_TRAVEL_M**2
        is_informative = moved and square > PARALLEL_N * travel_square * speed_square
        if weight < FEW_RESPONSES or not is_informative:
            return
        slope = (speed_force * product - travel_force * speed_square) / square
        rate = (speed_force * travel_square - travel_force * product) / square
        residual = max(force_square + slope * travel_force - rate * speed_force, 0.0)
        variance = residual / weight + settings.noise_N**2
        sigma = sqrt(variance * speed_square / square)
        if not sigma < SURE_SHARE * slope:
            return
        softest = 1.0 / (1.0 + k_N_m / SOFTEST_ARM_N_M)
        estimated = (SHARE_MARGIN * slope + SHARE_SIGMAS * sigma) / k_N_m
        estimated = min(max(estimated, softest), 1.0)
        self.share += (1.0 - exp(-dt_s / LEARN_S)) * (estimated - self.share)
