"""The tables of the force bench: `python -m bench force`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from itertools import product
from math import nan
from typing import get_args

from bench.force import settle
from bench.force.laws import ADAPTIVE, GUIDED, OF_REGULATOR
from bench.force.requirements import closest, requirements
from bench.force.rig import BAND_N, SceneSettings
from bench.force.scenes import SCENES, Scene
from bench.harness import CaseTable, Options, Tables, grid, grouped, worst
from bench.over_tcp import CELL
from bench.pages import heading
from bench.results import Row
from bench.settling import released
from cli.demo.cell import DemoOverrides, demo_cell
from cli.demo.scenario import ScenarioPlan
from forcemesh.messages import Host

STIFFEST_N_M, STAYS_S = 1e5, 2.0  # over TCP
TUNED_FOR = SceneSettings(2e4, 10)
MOST_OVERSHOOT_PCT = 25.0
WORLDS = [{"stiffness_N_m": k, "delay_ms": d}
          for k, d in ((5e3, 10), *product((2e4, 1e5), (10, 30)))]  # fmt: skip
SOFTEST_PLATE_N_M = 1e3  # that the simulated cell can be given


def settings(world: SceneSettings) -> Row:
    """Return the settings of a scene by the names of the columns."""
    return {**asdict(world), "speed_mm_s": 1e3 * world.speed_m_s}


def release_row(case: Row) -> Row:
    """Release by our law at first contact, and with the stiffness identified."""
    world = SceneSettings(**case)
    first, identified, stiffness_ratio = settle.ours(world)
    capped_s = 3.5 / (settle.KI_CAP * world.stiffness_N_m) + first.tau_s
    approach_s = (settle.PRESS_N - BAND_N) / (world.stiffness_N_m * world.speed_m_s)
    first_s = worst([first.settling_s])
    return {
        **settings(world),
        "first_s": first.settling_s,
        "first_tau": first.taus,
        "first_of_capped": first_s / capped_s,
        "first_of_limited": first_s / max(approach_s + 5.0 * first.tau_s, capped_s),
        "identified_s": identified.settling_s,
        "identified_tau": identified.taus,
        "overshoot_pct": max(first.overshoot_pct, identified.overshoot_pct),
        "stiffness_ratio": stiffness_ratio,
    }


def tcp_row(case: Row) -> Row:
    """Release from 30 N at first contact: gateway, TCP, the shipped program, in lock step.

    The stiffness is unknown: the cell states the stiffest contact. The step time of the emulated
    controller sets its delay and its loop rate.
    """
    trial = DemoOverrides(
        stiffness_N_m=STIFFEST_N_M, as_step_s=case["as_step_ms"] / 1e3, law=case["law"]
    )
    cell = demo_cell(CELL, trial)
    assert cell.sim is not None  # noqa: S101 - the demo's is simulated
    plate = cell.sim.model_copy(update={"stiffness_N_m": case["stiffness_N_m"]})
    plan = ScenarioPlan(host=case["host"], setpoint_N=0.0, settled_for_s=STAYS_S)
    found = released(cell.model_copy(update={"sim": plate}), plan)
    ms, hz = found.get("settling_ms"), found.pop("loop_hz", None)
    first = {"first_s": None if ms is None else ms / 1e3, "first_tau": found.get("settling_tau")}
    return {**case, **found, **first, "program_loop_hz": hz}


def fixed_gain_row(case: Row) -> Row:
    """Release by a PI law that is safe at 1e5 N/m, and by ours."""
    world = SceneSettings(**case)
    fixed = settle.plain(world, 0.45 / (1e5 * settle.true_tau_s(world)))
    _, identified, _ = settle.ours(world)
    return {**case, "fixed_s": fixed.settling_s, "identified_s": identified.settling_s}


def one_gain_row(case: Row) -> Row:
    """Release by a PI law tuned for one contact; one that lifts off has not settled."""
    gain = 0.45 / (TUNED_FOR.stiffness_N_m * settle.true_tau_s(TUNED_FOR))
    done = settle.plain(SceneSettings(**case), gain, longest_s=6.0)
    taus = nan if done.taus is None or done.overshoot_pct > MOST_OVERSHOOT_PCT else done.taus
    return {**case, "first_tau": taus}


def scene_row(case: Row, play: Scene) -> Row:
    """Return the measures of one law in one scene."""
    law, world = case["law"], SceneSettings(**{n: v for n, v in case.items() if n != "law"})
    measures = play(world, law)
    return {"law": law, **settings(world), **measures, "first_measure": next(iter(measures))}


def scene_table(name: str) -> CaseTable:
    """Return the table of a scene: every law in every world."""
    laws = [law for law in OF_REGULATOR if law != GUIDED or name.startswith("guide")]
    cases: list[Row] = [{"law": law, **world} for law, world in product(laws, WORLDS)]
    if name == "ten-times-stiffer":
        cases = [case for case in cases if case["stiffness_N_m"] >= 10.0 * SOFTEST_PLATE_N_M]
    if name == "wall-vanishes":
        slow = product((0.02, 0.05), WORLDS)
        cases += [{"law": ADAPTIVE, **world, "speed_m_s": v} for v, world in slow]
    return CaseTable(cases, partial(scene_row, play=SCENES[name]))


DELAYS_MS, SOME_N_M = settle.DELAYS_MS, (5e3, 2e4, 1e5)
TABLES = {
    "release": CaseTable(
        grid(
            delay_error_ms=(0.0, 5.0, 10.0, -5.0),
            delay_ms=DELAYS_MS,
            stiffness_N_m=settle.STIFFNESSES_N_M,
        ),
        release_row,
    ),
    "slow-loops": CaseTable(
        grid(delay_ms=(10, 120), loop_hz=(60.0, 30.0, 15.0), stiffness_N_m=SOME_N_M), release_row
    ),
    "limited-speed": CaseTable(
        grid(speed_m_s=(0.02, 0.05), delay_ms=(10,), stiffness_N_m=(1e3, 5e3, 2e4)), release_row
    ),
    "slow-brakes": CaseTable(
        grid(accel_m_s2=(1, 2, 5, 7.5), delay_ms=DELAYS_MS, stiffness_N_m=(5e3, 2e4, 2e5)),
        release_row,
    ),
    "over-tcp": CaseTable(
        grid(
            as_step_ms=(0.125, 0.2),
            host=get_args(Host),
            stiffness_N_m=SOME_N_M,
            law=("adaptive", "plain"),
        ),
        tcp_row,
    ),
    "fixed-gain": CaseTable([{"delay_ms": 10, "stiffness_N_m": 5e3}], fixed_gain_row),
    "one-gain": CaseTable(
        grid(delay_ms=DELAYS_MS, stiffness_N_m=settle.STIFFNESSES_N_M), one_gain_row
    ),
    **{name: scene_table(name) for name in SCENES},
}


def measure(options: Options) -> Tables:
    """Return every table, the peers' search, and the requirements on our law."""
    rows = {name: each.measured(options) for name, each in TABLES.items()}
    chosen, found = settle.searched(options)
    peers = list(with_ours(found, rows["release"]))
    required = requirements({**rows, "peers": peers})
    return {
        "closest": closest(required),
        "requirements": required,
        "weak-scenes": weak(rows),
        "peer-settings": chosen,
        "peers": peers,
        **rows,
    }


def weak(rows: Mapping[str, Sequence[Row]]) -> Iterator[Row]:
    """Yield the scenes in whose first measure another law is better than ours in its worst row."""
    for scene in SCENES:
        name = rows[scene][0]["first_measure"]
        by_law = {place["law"]: ours for place, ours in grouped(rows[scene], "law")}
        found = {law: worst(row[name] for row in by_law.get(law, ())) for law in OF_REGULATOR}
        if found[ADAPTIVE] > min(found.values()):
            yield {"scene": scene.replace("-", " "), "largest": heading(name), **found}


def with_ours(peers: Sequence[Row], releases: Sequence[Row]) -> Iterator[Row]:
    """Yield the peers' rows with our results in the same scene."""
    for peer in peers:
        scene = (peer["stiffness_N_m"], peer["delay_ms"], 0.0)
        for row in releases:
            if (row["stiffness_N_m"], row["delay_ms"], row["delay_error_ms"]) == scene:
                ours = {name: row[name] for name in ("first_s", "identified_s")}
                yield {**peer, **ours}
