"""The tables of the force bench: `python -m bench force`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from math import nan
from statistics import median
from typing import get_args

from bench.force import laws, scenes, search, settle
from bench.force.requirements import CLOSEST, closest, requirements
from bench.force.requirements import COLUMNS as REQUIREMENT
from bench.force.rig import SceneSettings
from bench.harness import CaseTable, Options, worst
from bench.over_tcp import CELL, released
from bench.pages import heading
from bench.results import Row, Table, table
from cli.demo.cell import DemoOverrides, demo_cell
from cli.demo.scenario import ScenarioPlan
from forcemesh.messages import Host, Law

PLACE = {"delay_ms": "g", "stiffness_N_m": "g"}
IN_TAU = {"first_tau": ".1f", "identified_tau": ".1f", "overshoot_pct": ".0f"}
IN_SECONDS = {"first_s": ".3g", "identified_s": ".3g", "overshoot_pct": ".1f"}

# --- releases -------------------------------------------------------------------------------------


def settings(world: SceneSettings) -> Row:
    """Return the settings of a scene by the names of the columns."""
    return {**asdict(world), "speed_mm_s": 1e3 * world.speed_m_s}


def release_row(world: SceneSettings) -> Row:
    """Release by our law at first contact, and with the stiffness identified."""
    first, identified, stiffness_ratio = settle.ours(world)
    return {
        **settings(world),
        "tau_s": first.tau_s,
        "first_s": first.settling_s,
        "first_tau": first.taus,
        "identified_s": identified.settling_s,
        "identified_tau": identified.taus,
        "overshoot_pct": max(first.overshoot_pct, identified.overshoot_pct),
        "stiffness_ratio": stiffness_ratio,
    }


RELEASES = [
    SceneSettings(k, delay_ms, delay_error_ms=error_ms)
    for error_ms, delay_ms, k in product(
        (0.0, 5.0, 10.0, -5.0), settle.DELAYS_MS, settle.STIFFNESSES_N_M
    )
]
SLOW_LOOPS = [
    SceneSettings(k, delay_ms, hz)
    for delay_ms, hz, k in product((10, 120), (60.0, 30.0, 15.0), (5e3, 2e4, 1e5))
]
LIMITED_SPEED = [
    SceneSettings(k, 10, speed_m_s=v) for v, k in product((0.02, 0.05), (1e3, 5e3, 2e4))
]
SLOW_BRAKES = [
    SceneSettings(k, delay_ms, accel_m_s2=a)
    for a, delay_ms, k in product((1, 2, 5, 7.5), settle.DELAYS_MS, (5e3, 2e4, 2e5))
]

# --- releases over TCP ----------------------------------------------------------------------------

STIFFEST_N_M, STAYS_S = 1e5, 2.0


@dataclass(frozen=True, slots=True)
class TcpRelease:
    """Release over TCP on a contact of unknown stiffness: the cell states the stiffest one.

    The step time of the emulated controller sets its delay and its loop rate.
    """

    law: Law
    as_step_ms: float
    host: Host
    stiffness_N_m: float


def tcp_row(case: TcpRelease) -> Row:
    """Release from 30 N at first contact: gateway, TCP, the shipped program, in lock step."""
    trial = DemoOverrides(stiffness_N_m=STIFFEST_N_M, as_step_s=case.as_step_ms / 1e3, law=case.law)
    cell = demo_cell(CELL, trial)
    if cell.sim is None:
        raise ValueError("the benchmark needs a simulated cell")
    plate = cell.sim.model_copy(update={"stiffness_N_m": case.stiffness_N_m})
    cell = cell.model_copy(update={"sim": plate})
    plan = ScenarioPlan(mode="position", host=case.host, setpoint_N=0.0, settled_for_s=STAYS_S)
    found = released(cell, plan)
    ms, hz = found.get("settling_ms"), found.pop("loop_hz", None)
    first = {"first_s": None if ms is None else ms / 1e3, "first_tau": found.get("settling_tau")}
    return {**asdict(case), **found, **first, "program_loop_hz": hz}


OVER_TCP = [
    TcpRelease(law, *place)
    for place in product((0.125, 0.2), get_args(Host), (5e3, 2e4, 1e5))
    for law in ("adaptive", "plain")
]

# --- a fixed gain ---------------------------------------------------------------------------------

TUNED_FOR = SceneSettings(2e4, 10)
MOST_OVERSHOOT_PCT = 25.0


def fixed_gain_row(world: SceneSettings) -> Row:
    """Release by a PI law that is safe at 1e5 N/m, and by ours."""
    gain = 0.45 / (1e5 * settle.true_tau_s(world))
    fixed, (_, identified, _) = settle.plain(world, gain), settle.ours(world)
    settled = {"fixed_s": fixed.settling_s, "identified_s": identified.settling_s}
    return {**settings(world), **settled}


def one_gain_row(world: SceneSettings) -> Row:
    """Release by a PI law tuned for one contact; one that lifts off has not settled."""
    gain = 0.45 / (TUNED_FOR.stiffness_N_m * settle.true_tau_s(TUNED_FOR))
    done = settle.plain(world, gain, longest_s=6.0)
    taus = nan if done.taus is None or done.overshoot_pct > MOST_OVERSHOOT_PCT else done.taus
    return {**settings(world), "first_tau": taus}


# --- scenes ---------------------------------------------------------------------------------------

LAWS: dict[str, laws.Make] = {
    "adaptive": laws.adaptive,
    "plain, safe at 2e5 N/m": laws.plain,
    "plain, known k": laws.tuned_plain,
    "hand guiding": laws.guided,
}
WORLDS = [SceneSettings(5e3, 10), *(SceneSettings(k, d) for k in (2e4, 1e5) for d in (10, 30))]
SOFTEST_PLATE_N_M = 1e3  # that the simulated cell can be given


@dataclass(frozen=True, slots=True)
class SceneJob:
    """One law in one scene."""

    scene: str
    law: str
    world: SceneSettings


def scene_row(job: SceneJob) -> Row:
    """Return the measures of one law in one scene."""
    measures = scenes.SCENES[job.scene].play(job.world, LAWS[job.law])
    return {"law": job.law, **settings(job.world), **measures}


def scene_jobs(name: str) -> list[SceneJob]:
    """Return every law and world of a scene."""
    names = [law for law in LAWS if law != "hand guiding" or name.startswith("guide")]
    jobs = [SceneJob(name, law, world) for law, world in product(names, WORLDS)]
    if name == "ten-times-stiffer":
        least_N_m = 10.0 * SOFTEST_PLATE_N_M
        return [job for job in jobs if job.world.stiffness_N_m >= least_N_m]
    if name == "wall-vanishes":
        slow = [replace(world, speed_m_s=v) for v in (0.02, 0.05) for world in WORLDS]
        jobs += [SceneJob(name, "adaptive", world) for world in slow]
    return jobs


def scene_table(name: str) -> CaseTable:
    """Return the table of a scene."""
    measures = dict.fromkeys(scenes.SCENES[name].measures.split(), ".3g")
    place = {"law": "", "stiffness_N_m": "g", "delay_ms": "g", "speed_mm_s": "g"}
    return CaseTable({**place, **measures}, scene_jobs(name), scene_row)


# --- all of them ----------------------------------------------------------------------------------

TABLES = {
    "release": CaseTable({"delay_error_ms": "g", **PLACE, **IN_TAU, "stiffness_ratio": ".2f"},
                         RELEASES, release_row),
    "slow-loops": CaseTable({"loop_hz": "g", **PLACE, **IN_SECONDS}, SLOW_LOOPS, release_row),
    "limited-speed": CaseTable({"speed_mm_s": "g", **PLACE, **IN_SECONDS}, LIMITED_SPEED,
                               release_row),
    "slow-brakes": CaseTable({"accel_m_s2": "g", **PLACE, **IN_TAU}, SLOW_BRAKES, release_row),
    "over-tcp": CaseTable(
        {"host": "", "as_step_ms": "g", "stiffness_N_m": "g", "law": "", "outcome": "",
         "first_s": ".3g", "overshoot_pct": ".1f", "program_loop_hz": ".0f"},
        OVER_TCP, tcp_row,
    ),
    "fixed-gain": CaseTable({**PLACE, "fixed_s": ".3g", "identified_s": ".3g"},
                            [SceneSettings(5e3, 10)], fixed_gain_row),
    "one-gain": CaseTable(
        {**PLACE, "first_tau": ".1f"},
        [SceneSettings(k, d) for d, k in product(settle.DELAYS_MS, settle.STIFFNESSES_N_M)],
        one_gain_row,
    ),
    **{name: scene_table(name) for name in scenes.SCENES},
}  # fmt: skip


SETTLING = {
    "delay_error_ms": "g", "median_first_tau": ".1f", "longest_first_tau": ".1f",
    "longest_identified_tau": ".1f", "largest_overshoot_pct": ".0f",
}  # fmt: skip
SCENES = {"scene": "", "largest": "", **dict.fromkeys(LAWS, ".3g")}


def measure(options: Options) -> dict[str, Table]:
    """Return every table, the peers' search, and the requirements on our law."""
    rows = {name: each.measured(options) for name, each in TABLES.items()}
    chosen, found = search.searched(options)
    peers = list(with_ours(found, rows["release"]))
    required = requirements({**rows, "peers": peers})
    compared = list(worst_of_scenes(rows))
    return {
        "closest": table(CLOSEST, closest(required)),
        "requirements": table(REQUIREMENT, required),
        "settling": table(SETTLING, settling(rows["release"])),
        "scenes": table(SCENES, compared),
        "weak-scenes": table(SCENES, weak(compared)),
        "peer-settings": table(search.SETTINGS, chosen),
        "peers": table(search.COLUMNS, peers),
        **{name: each.stored(rows[name]) for name, each in TABLES.items()},
    }


def settling(releases: Sequence[Row]) -> Iterator[Row]:
    """Yield the median and the worst by the error of the delay, from 5e3 N/m upwards."""
    stiff = [row for row in releases if row["stiffness_N_m"] >= 5e3]
    for error_ms in dict.fromkeys(row["delay_error_ms"] for row in stiff):
        ours = [row for row in stiff if row["delay_error_ms"] == error_ms]
        yield {
            "delay_error_ms": error_ms,
            "median_first_tau": median(worst([row["first_tau"]]) for row in ours),
            "longest_first_tau": worst(row["first_tau"] for row in ours),
            "longest_identified_tau": worst(row["identified_tau"] for row in ours),
            "largest_overshoot_pct": worst(row["overshoot_pct"] for row in ours),
        }


def worst_of_scenes(rows: Mapping[str, Sequence[Row]]) -> Iterator[Row]:
    """Yield the largest value of the first measure of each scene, by law."""
    for name, scene in scenes.SCENES.items():
        measure_name = scene.measures.split()[0]
        yield {
            "scene": name.replace("-", " "),
            "largest": heading(measure_name),
            **{
                law: worst(row[measure_name] for row in rows[name] if row["law"] == law)
                for law in LAWS
            },
        }


def weak(scenes_: Sequence[Row]) -> Iterator[Row]:
    """Yield the scenes in which another law has a smaller value than the adaptive one."""
    for row in scenes_:
        if row["adaptive"] > min(row[law] for law in LAWS):
            yield row


def with_ours(peers: Sequence[Row], releases: Sequence[Row]) -> Iterator[Row]:
    """Yield the peers' rows with our results in the same scene, and how much faster ours is."""
    ours = {
        (row["stiffness_N_m"], row["delay_ms"]): row
        for row in releases
        if row["delay_error_ms"] == 0.0
    }
    for peer in peers:
        row = ours.get((peer["stiffness_N_m"], peer["delay_ms"]))
        if row is not None:
            ratios = {
                f"{name}_ratio": None if theirs is None else theirs / row[f"{our}_s"]
                for name, our in (("one_setting", "first"), ("tuned_here", "identified"))
                for theirs in (peer[f"{name}_s"],)
            }
            yield {**peer, **{n: row[n] for n in ("first_s", "identified_s")}, **ratios}
