"""What records of an arm say about its delay, its lag and the stiffness of what it touches. Pure.

The model is the regulator's own: a command passes a pure delay and two equal first-order lags,

    y(t) = offset + lag/2 after lag/2 of command(t - delay)

The least squares over a grid of delays and lags, refined once, is robust against what a search by
gradients trips over: commands that hold between two periods, poses that come at their own pace.
"""

from dataclasses import dataclass

import numpy as np

from common.errors import DataError
from common.frames import Array

GRID_S = 0.0005  # of the model's time
COARSE_S = 0.002
FINER = ((0.008, 0.0005), (0.001, 0.0001))  # so far around the best so far, in such steps
LONGEST_DELAY_S, LONGEST_LAG_S = 0.25, 0.12
LEAST_SAMPLES = 20
LEAST_WAY_M = 2e-4
WORST_FIT = 0.15  # of the motion's deviation: a larger rest is no delay and lag
WORST_ANSWER = 0.2  # of the step of the set point
LEAST_PLACES = 2
LEAST_FORCE_N = 1.0


@dataclass(frozen=True, slots=True)
class Steps:
    """A command and what was seen of it, along one axis; times on one clock [s], places [m]."""

    sent_s: Array  # when each command came into force. Shape (N,)
    sent_m: Array
    seen_s: Array  # Shape (M,)
    seen_m: Array


@dataclass(frozen=True, slots=True)
class Servo:
    """What the records say."""

    delay_s: float
    lag_s: float
    rest_m: float  # deviation of what was seen from the model
    spread_s: float  # standard deviation of delay + lag


@dataclass(frozen=True, slots=True)
class Spring:
    """The stiffness along the press axis."""

    k_N_m: float
    spread_N_m: float  # standard deviation

    @property
    def bound_N_m(self) -> float:
        """What gains should be safe for: two deviations more."""
        return self.k_N_m + 2.0 * self.spread_N_m


def identify(steps: Steps) -> Servo:
    """Return delay and lag. Raises DataError when the records do not tell them."""
    _check(steps)
    start_s, end_s = steps.sent_s[0], steps.seen_s[-1]
    t = np.arange(start_s - LONGEST_DELAY_S, end_s + GRID_S, GRID_S)
    held = np.searchsorted(steps.sent_s, t, side="right") - 1
    command = steps.sent_m[np.maximum(held, 0)]
    useful = steps.seen_s > start_s
    seen_s, seen_m = steps.seen_s[useful], steps.seen_m[useful]
    lags = np.arange(0.0, LONGEST_LAG_S, COARSE_S)
    delays = np.arange(0.0, LONGEST_DELAY_S, COARSE_S)
    delay_s, lag_s, rest_m = _best(t, command, seen_s, seen_m, delays=delays, lags=lags)
    for around_s, step_s in FINER:
        off_s = np.arange(-around_s, around_s + 0.5 * step_s, step_s)
        delays, lags = np.maximum(delay_s + off_s, 0.0), np.maximum(lag_s + off_s, 0.0)
        delay_s, lag_s, rest_m = _best(t, command, seen_s, seen_m, delays=delays, lags=lags)
    if rest_m > WORST_FIT * float(np.std(seen_m)):
        share = 100.0 * rest_m / float(np.std(seen_m))
        raise DataError(f"the arm did not do what it was told: {share:.0f} % of its way is unlike")
    speed = np.gradient(
        np.interp(seen_s - delay_s, t, _lagged(command, np.array([lag_s]))[:, 0]), seen_s
    )
    spread_s = rest_m / max(float(np.linalg.norm(speed)), 1e-12)
    return Servo(delay_s, lag_s, rest_m, spread_s)


def spring(ways_m: Array, forces_N: Array) -> Spring:
    """Return the stiffness from places at rest: way into the surface and force that pushes back.

    Args:
        ways_m: Deeper is larger. Shape (N,).
        forces_N: Along the tool's axis; the tool presses with it. Shape (N,).

    Raises:
        DataError: Too few places, or the force does not rise with the way.
    """
    if len(ways_m) < LEAST_PLACES or np.ptp(forces_N) < LEAST_FORCE_N:
        raise DataError("the press did not change the force enough to tell a stiffness")
    way, force = ways_m - np.mean(ways_m), forces_N - np.mean(forces_N)
    along = float(force @ force)
    compliance = float(way @ force) / along  # way has the noise of poses: it is what is regressed
    if compliance <= 0.0:
        raise DataError("the force does not rise with the way: does something move?")
    rest_m = way - compliance * force
    spread = float(np.sqrt(rest_m @ rest_m / max(len(way) - 2, 1) / along))
    k = 1.0 / compliance
    return Spring(k, k * spread / compliance)


def loop_delay(
    t: Array, force_N: Array, *, first_N: float, then_N: float, ramp_N_s: float, rate: float
) -> float:
    """Return tau [s] of a closed loop from its answer to a new set point.

        dF/dt = -rate (F(t - tau) - F_set(t - tau)),    rate = k Ki

    Args:
        t: Since the set point was sent, growing [s]. Shape (N,).
        force_N: With which the tool presses. Shape (N,).
        first_N: Set point until then, at which the force rested.
        then_N: Set point that it goes to.
        ramp_N_s: How fast the set point goes there.
        rate: Stiffness times integral gain [1/s].

    Raises:
        DataError: The force did not follow.
    """
    taus = np.arange(COARSE_S, LONGEST_DELAY_S, COARSE_S)
    model = _answers(
        float(t[-1]), taus, first_N=first_N, then_N=then_N, ramp_N_s=ramp_N_s, rate=rate
    )
    grid = np.arange(model.shape[0]) * GRID_S
    off_N = [np.interp(t, grid, model[:, n]) - force_N for n in range(len(taus))]
    rests = [float(np.sqrt(np.mean(off * off))) for off in off_N]
    best = int(np.argmin(rests))
    if rests[best] > WORST_ANSWER * abs(then_N - first_N):
        raise DataError(
            f"the force did not follow its set point: {rests[best]:.1f} N off the model"
        )
    return float(taus[best])


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


def _check(steps: Steps) -> None:
    if min(len(steps.sent_s), len(steps.seen_s)) < LEAST_SAMPLES:
        raise DataError("too little was heard of commands and poses: is the machine too busy?")
    if np.ptp(steps.sent_m) < LEAST_WAY_M or np.ptp(steps.seen_m) < 0.3 * np.ptp(steps.sent_m):
        raise DataError("the arm did not go the small steps that it was told")


def _best(
    t: Array, command: Array, seen_s: Array, seen_m: Array, *, delays: Array, lags: Array
) -> tuple[float, float, float]:
    """Return the delay, the lag and the deviation of the best of all pairs."""
    lagged = _lagged(command, lags)
    best = (0.0, 0.0, float("inf"))
    for delay_s in delays:
        at = (seen_s - delay_s - t[0]) / GRID_S - 1.0  # a stage answers at the end of its step
        low = np.clip(at.astype(int), 0, len(t) - 2)
        share = np.clip(at - low, 0.0, 1.0)[:, None]
        off = (1.0 - share) * lagged[low] + share * lagged[low + 1] - seen_m[:, None]
        rests = np.std(off, axis=0)  # a constant offset does not count
        number = int(np.argmin(rests))
        if rests[number] < best[2]:
            best = (float(delay_s), float(lags[number]), float(rests[number]))
    return best


def _lagged(command: Array, lags: Array) -> Array:
    """Return the command after each of the lags, as two equal stages. Shape (time, N)."""
    half = 0.5 * lags
    share = np.where(half > 0.2 * GRID_S, -np.expm1(-GRID_S / np.maximum(half, 1e-9)), 1.0)
    first = arm = np.full(len(lags), command[0])
    out = np.empty((len(command), len(lags)))
    for number, value in enumerate(command):
        first = first + share * (value - first)
        arm = arm + share * (first - arm)
        out[number] = arm
    return out
