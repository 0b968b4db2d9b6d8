"""Grid search that tunes the peers: all candidates on all scenes, the same budget for each law.

One matrix gives both results: the setting that is best for all scenes, and for each scene the
best setting, with known stiffness and delay.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import product

import numpy as np

from bench.force import settle
from bench.force.peers import Admittance, Fdcc
from bench.force.pilots import LawRunner
from bench.force.rig import ForceRig, SceneSettings
from common.motion.frames import Array

LAWS = ("plain PI", "admittance", "FDCC-like")
GAINS_M_PER_NS = tuple(np.geomspace(2e-5, 1e-2, 10).tolist())
TIMES_S = (0.002, 0.01, 0.03)  # the second number of each law
SCENES = tuple(SceneSettings(k, d) for k, d in product((5e3, 2e4, 1e5), (0, 10, 30, 60)))
LONGEST_S = 3.0
NOT_SETTLED_S = 6.0  # what a run that does not settle is counted as
MOST_OVERSHOOT_PCT = 5.0


@dataclass(frozen=True, slots=True)
class Candidate:
    """One setting of one law."""

    law: str
    gain_m_per_Ns: float
    time_s: float


def candidates(law: str, part: int = 1) -> list[Candidate]:
    """Return the settings to try; `part`: use every n-th gain."""
    pairs = product(GAINS_M_PER_NS[::part], TIMES_S)
    return [Candidate(law, gain, time_s) for gain, time_s in pairs]


def score_s(job: tuple[Candidate, SceneSettings]) -> float:
    """Return the settling time of one release; excessive lift-off counts as not settled."""
    candidate, world = job
    cell = world.cell()
    rig = ForceRig(cell)
    rig.press(settle.PRESS_N)
    longest_m_s = cell.force.speed_max_m_s
    gain, time_s = candidate.gain_m_per_Ns, candidate.time_s
    pilot: settle.Presser
    if candidate.law == "plain PI":
        gain_p = 0.2 * gain * time_s / TIMES_S[-1]
        pilot = LawRunner("plain", cell, rig.T_base_tcp, gain_m_per_Ns=gain, gain_p_m_per_N=gain_p)
    elif candidate.law == "admittance":
        pilot = Admittance(rig.T_base_tcp, gain, time_s, longest_m_s=longest_m_s)
    else:
        pilot = Fdcc(rig.T_base_tcp, gain, time_s, longest_m_s=longest_m_s)
    done = settle.release(rig, pilot, world, LONGEST_S, most_overshoot_pct=MOST_OVERSHOOT_PCT)
    return NOT_SETTLED_S if done.settling_s is None else done.settling_s


@dataclass(frozen=True, slots=True)
class Tuned:
    """Results of the search for one law. Arrays over the scenes."""

    one: Candidate  # best for all: settles in most scenes, then least sum of logarithms
    one_s: Array
    each: tuple[Candidate, ...]
    each_s: Array


def tuned(law: str, scenes: Sequence[SceneSettings], pool: Executor, part: int = 1) -> Tuned:
    """Try every candidate on every scene."""
    tried = candidates(law, part)
    jobs = [(candidate, scene) for candidate in tried for scene in scenes]
    times = np.array(list(pool.map(score_s, jobs, chunksize=4))).reshape(len(tried), len(scenes))
    failed = (times >= NOT_SETTLED_S).sum(axis=1)
    best = int(np.lexsort((np.log(times).sum(axis=1), failed))[0])
    winners = times.argmin(axis=0)
    return Tuned(tried[best], times[best], tuple(tried[i] for i in winners), times.min(axis=0))
