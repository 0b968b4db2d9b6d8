"""Release from 30 N to zero: first contact with unknown stiffness, and with it identified."""

from dataclasses import dataclass, replace
from math import inf
from typing import Protocol

import numpy as np
import pinocchio as pin

from bench.force.laws import LawRunner, adaptive
from bench.force.measures import IGNORED_S, means, settling_s
from bench.force.rig import ForceRig, LawSample, SceneSettings, Trace

PRESS_N, BAND_N = 30.0, 1.0
STIFFNESSES_N_M = (1e3, 2e3, 5e3, 1e4, 2e4, 5e4, 1e5, 2e5)
DELAYS_MS = (0, 10, 30, 60)
CHUNK_S, ENOUGH_S = 0.1, 0.4  # the end of a run: so long within the band
LONGEST_S = 3.0
LONGEST_TAUS = 15.0
KI_CAP = 5e-3  # largest integral gain of the adaptive law on soft contacts [m/(N s)]


class Presser(Protocol):
    """A law with a set point."""

    setpoint_N: float

    def step(self, sample: LawSample) -> pin.SE3:
        """Return the TCP's next pose."""


@dataclass(frozen=True, slots=True)
class Release:
    """One release."""

    settling_s: float | None
    overshoot_pct: float  # true lift-off times stiffness, of the step
    tau_s: float  # true

    @property
    def taus(self) -> float | None:
        """Settling in tau."""
        return None if self.settling_s is None else self.settling_s / self.tau_s


def true_tau_s(world: SceneSettings) -> float:
    """Return all delay and lag of the loop, without the delay error [s]."""
    return replace(world, delay_error_ms=0.0).cell().loop_delay_s


def release(
    rig: ForceRig,
    pilot: Presser,
    world: SceneSettings,
    longest_s: float = LONGEST_S,
    *,
    most_overshoot_pct: float = inf,
) -> Release:
    """Let a law reduce the force to zero; end early on excessive lift-off."""
    pilot.setpoint_N = 0.0
    trace, t = Trace(), 0.0
    while t < longest_s:
        rig.run(pilot, CHUNK_S, trace)
        t = trace.t_s[-1]
        last = np.array(trace.push_N)[np.array(trace.t_s) > t - ENOUGH_S]
        over_pct = _overshoot_pct(trace, world)
        if over_pct > most_overshoot_pct:
            return Release(None, over_pct, true_tau_s(world))
        if t >= ENOUGH_S and float(np.abs(last).max()) < 0.8 * BAND_N:
            break
    settled = settling_s(np.array(trace.t_s), np.array(trace.push_N), BAND_N)
    return Release(settled, _overshoot_pct(trace, world), true_tau_s(world))


def _overshoot_pct(trace: Trace, world: SceneSettings) -> float:
    time_s = np.array(trace.t_s)
    lifted_m = means(time_s, np.array(trace.lift_off_m))[time_s >= IGNORED_S]
    return 100.0 * float(lifted_m.max(initial=0.0)) * world.stiffness_N_m / PRESS_N


def ours(world: SceneSettings) -> tuple[Release, Release, float]:
    """Return the release at first contact, one with identified stiffness, and its estimate.

    The estimate is relative to the true stiffness; the tool presses again between the releases.
    """
    rig = ForceRig(world.cell())
    rig.press(PRESS_N)
    pilot = adaptive(rig)
    soft_s = 1.0 / (KI_CAP * world.stiffness_N_m)
    longest_s = max(1.0, LONGEST_TAUS * true_tau_s(world), 8.0 * soft_s)
    first = release(rig, pilot, world, longest_s)
    for setpoint_N in (0.5 * PRESS_N, PRESS_N):
        pilot.setpoint_N = setpoint_N
        for _ in range(40):
            rig.run(pilot, 0.1)
            if abs(rig.push_N() - setpoint_N) < 0.5 * BAND_N:
                break
        rig.run(pilot, 0.3 + 2.0 * soft_s)
    stiffness_ratio = float(pilot.state.k_N_m[2]) / world.stiffness_N_m
    return first, release(rig, pilot, world, longest_s), stiffness_ratio


def plain(world: SceneSettings, gain_m_per_Ns: float, longest_s: float = 20.0) -> Release:
    """Return the same with the PI law at a fixed gain."""
    rig = ForceRig(world.cell())
    rig.press(PRESS_N)
    return release(rig, LawRunner(rig, "plain", gain_m_per_Ns), world, longest_s)
