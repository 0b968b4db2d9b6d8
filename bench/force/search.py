"""Grid search that tunes the peers: all candidates on all scenes, the same budget for each law.

One matrix gives both results: the setting that is best for all scenes, and for each scene the
best setting, with known stiffness and delay.
"""

from dataclasses import asdict, dataclass
from itertools import product

import numpy as np

from bench.force import settle
from bench.force.laws import LawRunner, Peer, PeerKind
from bench.force.rig import ForceRig, SceneSettings
from bench.harness import QUICK_STEP, Options
from bench.results import Row

LAWS = ("plain PI", "admittance", "FDCC-like")
GAINS_M_PER_NS = tuple(np.geomspace(2e-5, 1e-2, 10).tolist())
TIMES_S = (0.002, 0.01, 0.03)  # the second number of each law
SCENES = tuple(SceneSettings(k, d) for k, d in product((5e3, 2e4, 1e5), (0, 10, 30, 60)))
LONGEST_S = 3.0
NOT_SETTLED_S = 6.0  # what a run that does not settle is counted as
MOST_OVERSHOOT_PCT = 5.0
SETTINGS = {"law": "", "gain_m_per_Ns": ".2g", "time_s": "g"}
COLUMNS = {
    "law": "", "stiffness_N_m": "g", "delay_ms": "g",
    "one_setting_s": ".3g", "tuned_here_s": ".3g", "first_s": ".3g", "identified_s": ".3g",
    "one_setting_ratio": ".2g", "tuned_here_ratio": ".2g",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Candidate:
    """One setting of one law."""

    law: str
    gain_m_per_Ns: float
    time_s: float


def score_s(job: tuple[Candidate, SceneSettings]) -> float:
    """Return the settling time of one release; excessive lift-off counts as not settled."""
    candidate, world = job
    rig = ForceRig(world.cell())
    rig.press(settle.PRESS_N)
    gain, time_s = candidate.gain_m_per_Ns, candidate.time_s
    pilot: settle.Presser
    if candidate.law == "plain PI":
        pilot = LawRunner(rig, "plain", gain, 0.2 * gain * time_s / TIMES_S[-1])
    else:
        kind: PeerKind = "admittance" if candidate.law == "admittance" else "FDCC-like"
        longest_m_s = rig.cell.force.speed_max_m_s
        pilot = Peer(kind, rig.T_base_tcp, gain, time_s, longest_m_s=longest_m_s)
    done = settle.release(rig, pilot, world, LONGEST_S, most_overshoot_pct=MOST_OVERSHOOT_PCT)
    return NOT_SETTLED_S if done.settling_s is None else done.settling_s


def searched(options: Options) -> tuple[list[Row], list[Row]]:
    """Return the setting of each law that is best for all scenes, and the results in each scene.

    Best: it settles in most scenes, then the sum of the logarithms is least.
    """
    settings, rows = list[Row](), list[Row]()
    worlds = SCENES[:: QUICK_STEP if options.quick else 1]
    gains = GAINS_M_PER_NS[:: 5 if options.quick else 1]
    for law in LAWS:
        tried = [Candidate(law, *pair) for pair in product(gains, TIMES_S)]
        jobs = [(candidate, world) for candidate in tried for world in worlds]
        found = np.array(list(options.pool.map(score_s, jobs, chunksize=4)))
        times_s = found.reshape(len(tried), len(worlds))
        failed = (times_s >= NOT_SETTLED_S).sum(axis=1)
        best = int(np.lexsort((np.log(times_s).sum(axis=1), failed))[0])
        settings.append(asdict(tried[best]))
        for world, one_s, here_s in zip(worlds, times_s[best], times_s.min(axis=0), strict=True):
            rows.append({
                "law": law,
                "stiffness_N_m": world.stiffness_N_m,
                "delay_ms": world.delay_ms,
                "one_setting_s": None if one_s >= NOT_SETTLED_S else float(one_s),
                "tuned_here_s": None if here_s >= NOT_SETTLED_S else float(here_s),
            })  # fmt: skip
    return settings, rows
