"""Delay of a closed force loop, identified from its step response. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from common.motion.frames import Array
from forcemesh.errors import DataError

GRID_S = 0.0005  # of the model's time
STEP_S = 0.002  # grid of the candidate delays
LONGEST_RESPONSE_S = 0.3
MOST_RESIDUAL_SHARE = 0.2  # largest residual, as a share of the set point step
LEAST_RESPONSES, MOST_RESPONSES = 2, 5
RESPONSE_REPEATS_S = 0.005
MOST_CORRELATION = 0.99
SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class ContactResponse:
    """Total delay of a closed loop, with its standard deviation."""

    tau_s: float
    deviation_s: float  # standard deviation

    @property
    def bound_s(self) -> float:
        """Delay plus two standard deviations: the delay to design gains for."""
        return self.tau_s + SIGMAS * self.deviation_s


def loop_delay(
    t: Array, force_N: Array, *, first_N: float, then_N: float, ramp_N_s: float, rate: float
) -> ContactResponse:
    """Return tau of a closed loop from its response to a new set point.

        dF/dt = -rate (F(t - tau) - F_set(t - tau)),    rate = k Ki

    Args:
        t: Time since the set point was sent, increasing [s]. Shape (N,).
        force_N: Press force of the tool. Shape (N,).
        first_N: Previous set point, at which the force was at rest.
        then_N: New set point.
        ramp_N_s: Rate of the set point ramp.
        rate: Stiffness times integral gain [1/s].

    Raises:
        DataError: The force did not follow, or the delay is out of range.
    """
    taus = np.arange(STEP_S, LONGEST_RESPONSE_S, STEP_S)
    model = _modelled_forces(
        float(t[-1]), taus, first_N=first_N, then_N=then_N, ramp_N_s=ramp_N_s, rate=rate
    )
    grid = np.arange(model.shape[0]) * GRID_S
    residual_N = np.stack([np.interp(t, grid, column) - force_N for column in model.T])
    rms_N = np.sqrt(np.mean(residual_N * residual_N, axis=1))
    best = int(np.argmin(rms_N))
    if rms_N[best] > MOST_RESIDUAL_SHARE * abs(then_N - first_N) or best == len(taus) - 1:
        raise DataError(
            f"the force did not follow its set point: residual {rms_N[best]:.1f} N to the model, "
            f"whose delay is {1e3 * LONGEST_RESPONSE_S:.0f} ms at most"
        )
    return ContactResponse(float(taus[best]), _deviation_s(residual_N, best))


def repeats_within_s(segment_s: float) -> float:
    """Return the largest difference of two delays that count as repeated [s].

    A set point waits for the end of the segment in work, for none or for a whole one.
    """
    return RESPONSE_REPEATS_S + segment_s


def delay_repeats(responses: Sequence[ContactResponse], within_s: float) -> bool:
    """Return whether the last two delays agree."""
    if len(responses) < LEAST_RESPONSES:
        return False
    before, last = responses[-2:]
    return abs(last.tau_s - before.tau_s) <= within_s


def mean_response(responses: Sequence[ContactResponse]) -> ContactResponse:
    """Return the mean of repeated delays; the variance between them is not divided."""
    taus_s = np.array([response.tau_s for response in responses])
    noise_s = np.array([response.deviation_s for response in responses])
    variance = np.var(taus_s) + np.mean(noise_s**2) / len(responses)
    return ContactResponse(float(np.mean(taus_s)), sqrt(float(variance)))


def _deviation_s(residual_N: Array, best: int) -> float:
    """Return the standard deviation of the best delay, from its residuals and their slope."""
    low, high = max(best - 1, 0), best + 1
    slope = (residual_N[high] - residual_N[low]) / ((high - low) * STEP_S)
    residual = residual_N[best]
    square = float(residual @ residual)
    correlation = float(
        np.clip(residual[1:] @ residual[:-1] / max(square, 1e-12), 0.0, MOST_CORRELATION)
    )
    variance_inflation = (1.0 + correlation) / (1.0 - correlation)
    noise = square / len(residual) * variance_inflation / max(float(slope @ slope), 1e-12)
    return sqrt(noise + STEP_S**2 / 12.0)


def _modelled_forces(
    duration_s: float, taus: Array, *, first_N: float, then_N: float, ramp_N_s: float, rate: float
) -> Array:
    """Return modelled forces over a time grid, one column for each tau. Shape (time, N)."""
    count = int(duration_s / GRID_S) + 2
    delay_steps = np.maximum(1, np.round(taus / GRID_S).astype(int))
    step_N, sign = abs(then_N - first_N), np.sign(then_N - first_N)
    setpoint = first_N + sign * np.minimum(step_N, ramp_N_s * np.arange(count) * GRID_S)
    force = np.full((count, len(taus)), first_N)
    columns = np.arange(len(taus))
    for step in range(1, count):
        then = np.maximum(step - delay_steps, 0)
        error = force[then, columns] - np.where(step > delay_steps, setpoint[then], first_N)
        force[step] = force[step - 1] - rate * GRID_S * error
    return force
