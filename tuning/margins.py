"""Stability margins of a force loop, and its simulated step response. Pure.

    L(s) = Ki/s (k + m s^2) P(s) F(s) exp(-s D)

P is the servo, two equal first-order lags of total time `lag`; F the low-pass filter of the wrench;
D the total dead time: controller, processes, median, half a period; m s^2 the inertial force of the
mass in front of the sensor. For rotation, k, Ki and m are tilt stiffness, torque gain, and moment
of inertia.
"""

from dataclasses import dataclass, replace
from math import degrees, inf, pi

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array

FREQUENCY_POINTS = 6000
BAND = 1.0 / 30.0  # settling band as a share of the step: 1 N of 30 N
LONGEST_TAUS = 200.0
DIVERGED = 20.0  # multiple of the step beyond which the response counts as diverged
Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Loop:
    """One force loop; units of position, or of rotation."""

    stiffness: float  # N/m or N m/rad
    gain: float  # m/(N s) or rad/(N m s)
    delay_s: float  # total dead time
    lag_s: float
    filter_s: float
    inertia: float  # kg or kg m^2

    @property
    def tau_s(self) -> float:
        """Total delay and lag."""
        return self.delay_s + self.lag_s + self.filter_s

    @property
    def loop_gain(self) -> float:
        """Stiffness times gain times tau: 0.45 by the gain rule, 1.57 at the stability limit."""
        return self.stiffness * self.gain * self.tau_s

    def with_gain(self, gain: float) -> "Loop":
        """Return the same loop with another gain."""
        return replace(self, gain=gain)


@dataclass(frozen=True, slots=True)
class Margins:
    """Stability margins of a loop; zero when it is unstable."""

    stable: bool
    phase_deg: float  # phase margin
    gain_margin: float  # allowed factor of the gain, or of the stiffness
    delay_s: float  # delay margin: delay that may be added
    crossover_rad_s: float


@dataclass(frozen=True, slots=True)
class Forecast:
    """Simulated step response of a loop: settling time and overshoot."""

    settling_s: float | None  # to within a thirtieth of the step; None: never
    overshoot_pct: float


def response(loop: Loop, w: Array) -> Complex:
    """Return L at frequencies [rad/s]. Shape (N,)."""
    s = 1j * w
    servo = 1.0 / (1.0 + 0.5 * loop.lag_s * s) ** 2
    force = (loop.stiffness + loop.inertia * s * s) / (1.0 + loop.filter_s * s)
    loop_response: Complex = loop.gain / s * force * servo * np.exp(-loop.delay_s * s)
    return loop_response


def frequencies(loop: Loop) -> Array:
    """Return the relevant frequency grid of a loop [rad/s]. Shape (N,)."""
    lowest = min(1e-2, 0.1 * loop.loop_gain) if loop.gain > 0.0 else 1e-2
    return np.geomspace(lowest / loop.tau_s, 2e3 / loop.tau_s, FREQUENCY_POINTS)


def margins(loop: Loop) -> Margins:
    """Return the margins from L on a frequency grid (Nyquist criterion)."""
    if loop.gain <= 0.0:
        return Margins(
            stable=True, phase_deg=90.0, gain_margin=inf, delay_s=inf, crossover_rad_s=0.0
        )
    w = frequencies(loop)
    L = response(loop, w)
    size, phase = np.abs(L), np.unwrap(np.angle(L))
    # One integrator, no unstable pole: stable when 1 + L turns by pi/2 for w from 0 to infinity.
    turned = float(np.diff(np.unwrap(np.angle(1.0 + L))[[0, -1]])[0])
    stable = abs(turned - 0.5 * pi) < 0.5 * pi and size[-1] < 1.0
    if not stable:
        return Margins(
            stable=False, phase_deg=0.0, gain_margin=0.0, delay_s=0.0, crossover_rad_s=0.0
        )
    log_size = np.log(size)
    crossings = _crossings(log_size)
    lead = np.mod(_at(phase, crossings) + pi, 2.0 * pi)
    at = np.exp(_at(np.log(w), crossings))
    imaginary_crossings = _crossings(np.mod(phase + 2.0 * pi, 2.0 * pi) - pi)
    sign_changes = 1.0 / np.exp(
        _at(log_size, imaginary_crossings[_at(L.real, imaginary_crossings) < 0.0])
    )
    symmetric = np.minimum(lead, 2.0 * pi - lead)
    least = int(np.argmin(symmetric))
    return Margins(
        stable=True,
        phase_deg=degrees(float(symmetric[least])),
        gain_margin=float(min((g for g in sign_changes if g > 1.0), default=inf)),
        delay_s=float(np.min(lead / at)),
        crossover_rad_s=float(at[least]),
    )


def forecast(loop: Loop) -> Forecast:
    """Return settling time and overshoot of a unit step, simulated in the time domain."""
    t, force = release_response(loop)
    outside = np.flatnonzero(np.abs(force) > BAND)
    is_unsettled = len(outside) > 0 and outside[-1] >= len(t) - 2
    settling_s = None if is_unsettled else float(t[outside[-1] + 1]) if len(outside) else 0.0
    return Forecast(settling_s, 100.0 * max(0.0, -float(force.min())))


def release_response(loop: Loop, taus: float | None = None) -> tuple[Array, Array]:
    """Return time and force of a release from unit force to zero, starting at rest.

    Args:
        loop: The loop.
        taus: Duration in tau; default: long enough for the gain, at most 200 tau.
    """
    if taus is None:
        taus = min(max(30.0, 10.0 / max(loop.loop_gain, 1e-9)), LONGEST_TAUS)
    dt_s = min(loop.tau_s / 60.0, 0.1 * loop.lag_s) if loop.lag_s > 0.0 else loop.tau_s / 60.0
    count, late = int(taus * loop.tau_s / dt_s), round(loop.delay_s / dt_s)
    half_s = max(0.5 * loop.lag_s, 0.5 * dt_s)
    # Plain Python floats: numpy scalars take three times as long in this loop.
    lagging = float(1.0 - np.exp(-dt_s / half_s))
    is_filtered = loop.filter_s > 0.1 * dt_s
    filtering = float(1.0 - np.exp(-dt_s / loop.filter_s)) if is_filtered else 1.0
    sent = [0.0] * (late + 1)
    first = arm = speed = 0.0
    measured, forces = 1.0, [1.0]
    for _ in range(count):
        sent.append(sent[-1] - loop.gain * measured * dt_s)
        first += lagging * (sent[len(sent) - 2 - late] - first)
        before, moved = speed, lagging * (first - arm)
        arm += moved
        speed = moved / dt_s
        force = 1.0 + loop.stiffness * arm + loop.inertia * (speed - before) / dt_s
        measured += filtering * (force - measured)
        forces.append(measured)
        if abs(measured) > DIVERGED:
            break
    return dt_s * np.arange(len(forces), dtype=float), np.array(forces)


def _crossings(values: Array) -> Array:
    """Return the zero crossings without jumps, as fractional indices."""
    change = np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))
    before, after = values[change], values[change + 1]
    smooth = np.abs(after - before) < pi
    return np.asarray(change + before / (before - after))[smooth]


def _at(values: Array, places: Array) -> Array:
    return np.asarray(np.interp(places, np.arange(len(values)), values))
