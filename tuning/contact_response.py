"""How late a closed loop answers, from its force after a step of the set point. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from common.motion.frames import Array
from forcemesh.errors import DataError

GRID_S = 0.0005  # of the model's time
STEP_S = 0.002  # between the delays that are tried
LONGEST_TAU_S = 0.3
WORST_ANSWER = 0.2  # of the step of the set point
LEAST_ANSWERS, MOST_ANSWERS = 2, 5
REPEATS_S = 0.005  # two answers that are no farther apart are the same
MOST_ALIKE = 0.99
SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class Answer:
    """All delay of a closed loop."""

    tau_s: float
    deviation_s: float  # standard deviation

    @property
    def bound_s(self) -> float:
        """Delay that gains should be safe for."""
        return self.tau_s + SIGMAS * self.deviation_s


def loop_delay(
    t: Array, force_N: Array, *, first_N: float, then_N: float, ramp_N_s: float, rate: float
) -> Answer:
    """Return tau of a closed loop from its answer to a new set point.

        dF/dt = -rate (F(t - tau) - F_set(t - tau)),    rate = k Ki

    Args:
        t: Since the set point was sent, growing [s]. Shape (N,).
        force_N: With which the tool presses. Shape (N,).
        first_N: Set point until then, at which the force rested.
        then_N: Set point that it goes to.
        ramp_N_s: How fast the set point goes there.
        rate: Stiffness times integral gain [1/s].

    Raises:
        DataError: The force did not follow, or too late to tell.
    """
    taus = np.arange(STEP_S, LONGEST_TAU_S, STEP_S)
    model = _answers(
        float(t[-1]), taus, first_N=first_N, then_N=then_N, ramp_N_s=ramp_N_s, rate=rate
    )
    grid = np.arange(model.shape[0]) * GRID_S
    off_N = np.stack([np.interp(t, grid, column) - force_N for column in model.T])
    rests = np.sqrt(np.mean(off_N * off_N, axis=1))
    best = int(np.argmin(rests))
    if rests[best] > WORST_ANSWER * abs(then_N - first_N) or best == len(taus) - 1:
        raise DataError(
            f"the force did not follow its set point: {rests[best]:.1f} N off the model, whose "
            f"delay is {1e3 * LONGEST_TAU_S:.0f} ms at most"
        )
    return Answer(float(taus[best]), _deviation_s(off_N, best))


def repeats(answers: Sequence[Answer]) -> bool:
    """Tell whether the last two answers are the same."""
    if len(answers) < LEAST_ANSWERS:
        return False
    before, last = answers[-2:]
    return abs(last.tau_s - before.tau_s) <= REPEATS_S


def together(answers: Sequence[Answer]) -> Answer:
    """Return what answers that agree show together; how far they are apart counts undivided."""
    taus_s = np.array([answer.tau_s for answer in answers])
    noise_s = np.array([answer.deviation_s for answer in answers])
    variance = np.var(taus_s) + np.mean(noise_s**2) / len(answers)
    return Answer(float(np.mean(taus_s)), sqrt(float(variance)))


def _deviation_s(off_N: Array, best: int) -> float:
    """Return the deviation of the best delay, from what it leaves and how that changes with it."""
    low, high = max(best - 1, 0), best + 1
    slope = (off_N[high] - off_N[low]) / ((high - low) * STEP_S)
    rest = off_N[best]
    square = float(rest @ rest)
    alike = float(np.clip(rest[1:] @ rest[:-1] / max(square, 1e-12), 0.0, MOST_ALIKE))
    fewer = (1.0 + alike) / (1.0 - alike)
    noise = square / len(rest) * fewer / max(float(slope @ slope), 1e-12)
    return sqrt(noise + STEP_S**2 / 12.0)


def _answers(
    duration_s: float, taus: Array, *, first_N: float, then_N: float, ramp_N_s: float, rate: float
) -> Array:
    """Return forces over a grid of time, one column for each tau. Shape (time, N)."""
    count = int(duration_s / GRID_S) + 2
    late = np.maximum(1, np.round(taus / GRID_S).astype(int))
    way_N, sign = abs(then_N - first_N), np.sign(then_N - first_N)
    wanted = first_N + sign * np.minimum(way_N, ramp_N_s * np.arange(count) * GRID_S)
    force = np.full((count, len(taus)), first_N)
    columns = np.arange(len(taus))
    for step in range(1, count):
        then = np.maximum(step - late, 0)
        error = force[then, columns] - np.where(step > late, wanted[then], first_N)
        force[step] = force[step - 1] - rate * GRID_S * error
    return force
