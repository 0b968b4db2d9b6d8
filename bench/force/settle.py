"""Release from 30 N to zero: first contact with unknown stiffness, and with it identified."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pinocchio as pin

from bench.force.measures import IGNORED_S, means, settling_s
from bench.force.pilots import LawRunner
from bench.force.rig import ForceRig, LawSample, SceneSettings, Trace
from common.config.cell import CellConfig

PRESS_N, BAND_N = 30.0, 1.0
STIFFNESSES_N_M = (1e3, 2e3, 5e3, 1e4, 2e4, 5e4, 1e5, 2e5)
DELAYS_MS = (0, 10, 30, 60)
CHUNK_S, ENOUGH_S = 0.1, 0.4  # the end of a run: so long within the band
LONGEST_S = 3.0
LONGEST_TAUS = 15.0


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
    stiffness_ratio: float = 0.0  # estimated stiffness, relative to the true one

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
    most_overshoot_pct: float = float("inf"),
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


def ours(world: SceneSettings) -> tuple[Release, Release]:
    """Return first contact and, after pressing again, a release with identified stiffness."""
    cell = world.cell()
    rig = ForceRig(cell)
    rig.press(PRESS_N)
    pilot = LawRunner("adaptive", cell, rig.T_base_tcp, rig.arm.T_base_tcp)
    longest_s = max(1.0, LONGEST_TAUS * true_tau_s(world), 8.0 / (5e-3 * world.stiffness_N_m))
    first = release(rig, pilot, world, longest_s)
    for setpoint_N in (0.5 * PRESS_N, PRESS_N):
        pilot.setpoint_N = setpoint_N
        for _ in range(40):
            rig.run(pilot, 0.1)
            if abs(rig.push_N() - setpoint_N) < 0.5 * BAND_N:
                break
        rig.run(pilot, 0.3 + 2.0 / (5e-3 * world.stiffness_N_m))
    stiffness_ratio = float(pilot.state.k_N_m[2]) / world.stiffness_N_m
    identified = release(rig, pilot, world, longest_s)
    return first, Release(
        identified.settling_s, identified.overshoot_pct, identified.tau_s, stiffness_ratio
    )


def plain(world: SceneSettings, gain_m_per_Ns: float, longest_s: float = 20.0) -> Release:
    """Return the same with the PI law at a fixed gain."""
    cell: CellConfig = world.cell()
    rig = ForceRig(cell)
    rig.press(PRESS_N)
    pilot = LawRunner("plain", cell, rig.T_base_tcp, gain_m_per_Ns=gain_m_per_Ns)
    return release(rig, pilot, world, longest_s)
