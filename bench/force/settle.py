"""Release from 30 N to zero: first contact with unknown stiffness, and with it identified.

The peers are tuned by a grid search: all candidates on all scenes, the same budget for each law.
One matrix gives both results: the setting that is best for all scenes, and for each scene the
best setting, with known stiffness and delay.
"""

from dataclasses import dataclass, replace
from itertools import product
from math import inf

import numpy as np

from bench.force.laws import AnyLaw, LawRunner, Peer
from bench.force.rig import BAND_N, ForceRig, SceneSettings, Trace, means
from bench.harness import QUICK_STEP, Options, grid
from bench.results import Row

PRESS_N = 30.0
STIFFNESSES_N_M = (1e3, 2e3, 5e3, 1e4, 2e4, 5e4, 1e5, 2e5)
DELAYS_MS = (0, 10, 30, 60)
CHUNK_S, ENOUGH_S = 0.1, 0.4  # the end of a run: so long within the band
LONGEST_S = 3.0
LONGEST_TAUS = 15.0
IGNORED_S = 0.015  # in which the tool's inertia appears as force
KI_CAP = 5e-3  # largest integral gain of the adaptive law on soft contacts [m/(N s)]


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
    return replace(world, delay_error_ms=0.0).cell().plant.tau_s


def release(
    rig: ForceRig,
    pilot: AnyLaw,
    world: SceneSettings,
    longest_s: float = LONGEST_S,
    *,
    most_overshoot_pct: float = inf,
) -> Release:
    """Let a law reduce the force to zero; end early on excessive lift-off."""
    pilot.setpoint_N = 0.0
    trace, t, over_pct = Trace(), 0.0, 0.0
    while t < longest_s:
        rig.run(pilot, CHUNK_S, trace)
        t = trace.t_s[-1]
        over_pct = _overshoot_pct(trace, world)
        if over_pct > most_overshoot_pct:
            return Release(None, over_pct, true_tau_s(world))
        if t >= ENOUGH_S and is_steady(trace, 0.0, ENOUGH_S):
            break
    return Release(trace.settling_s(0.0), over_pct, true_tau_s(world))


def is_steady(trace: Trace, setpoint_N: float, last_s: float) -> bool:
    """Return whether the push was near a set point in the last time of a trace."""
    last_N = np.array(trace.push_N)[np.array(trace.t_s) > trace.t_s[-1] - last_s]
    return bool(np.abs(last_N - setpoint_N).max() < 0.8 * BAND_N)


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
    pilot = LawRunner(rig, "adaptive")
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


LAWS = ("plain PI", "admittance", "FDCC-like")
GAINS_M_PER_NS = tuple(np.geomspace(2e-5, 1e-2, 10).tolist())
TIMES_S = (0.002, 0.01, 0.03)  # the second number of each law
SCENES = grid(stiffness_N_m=(5e3, 2e4, 1e5), delay_ms=(0, 10, 30, 60))
NOT_SETTLED_S = 6.0  # what a run that does not settle is counted as
MOST_OVERSHOOT_PCT = 5.0


def score_s(job: tuple[Row, Row]) -> float:
    """Return the settling time of one release; excessive lift-off counts as not settled."""
    (law, gain, time_s), world = job[0].values(), SceneSettings(**job[1])
    rig = ForceRig(world.cell())
    rig.press(PRESS_N)
    pilot: AnyLaw
    if law == "plain PI":
        pilot = LawRunner(rig, "plain", gain, 0.2 * gain * time_s / TIMES_S[-1])
    else:
        pilot = Peer(law, rig, gain, time_s)
    done = release(rig, pilot, world, most_overshoot_pct=MOST_OVERSHOOT_PCT)
    return NOT_SETTLED_S if done.settling_s is None else done.settling_s


def searched(options: Options) -> tuple[list[Row], list[Row]]:
    """Return the setting of each law that is best for all scenes, and the results in each scene.

    Best: it settles in most scenes, then the sum of the logarithms is least.
    """
    settings, rows = list[Row](), list[Row]()
    worlds = SCENES[:: QUICK_STEP if options.quick else 1]
    gains = GAINS_M_PER_NS[:: 5 if options.quick else 1]
    for law in LAWS:
        tried = grid(law=[law], gain_m_per_Ns=gains, time_s=TIMES_S)
        found = options.pool.map(score_s, product(tried, worlds), chunksize=4)
        times_s = np.array(list(found)).reshape(len(tried), len(worlds))
        failed = (times_s >= NOT_SETTLED_S).sum(axis=1)
        best = int(np.lexsort((np.log(times_s).sum(axis=1), failed))[0])
        settings.append(tried[best])
        for world, one_s, here_s in zip(worlds, times_s[best], times_s.min(axis=0), strict=True):
            results = {"one_setting_s": one_s, "tuned_here_s": here_s}
            settled = {name: float(s) for name, s in results.items() if s < NOT_SETTLED_S}
            rows.append({"law": law, **world, **settled})
    return settings, rows
