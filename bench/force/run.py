"""Runner of all parts of the benchmark; collects plain numbers for JSON."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from bench.force import scenes, search, settle, stage, tcp_releases
from bench.force.rig import SceneSettings
from bench.force.settle import Release

Row = dict[str, Any]
DELAY_ERRORS_MS = (0.0, 5.0, 10.0, -5.0)
LOOPS_HZ = (60.0, 30.0, 15.0)
SLOW_DELAYS_MS = (10, 120)
LAWS: dict[str, stage.Make] = {
    "adaptive": stage.adaptive,
    "plain, safe at 2e5 N/m": stage.plain,
    "plain, known k": stage.tuned_plain,
}
HAND_GUIDING = "hand guiding"
GUIDED = ("guide", "guide to a wall")
SCENE_WORLDS = (
    SceneSettings(5e3, 10),
    *(SceneSettings(k, d) for k, d in product((2e4, 1e5), (10, 30))),
)
LIMITED = tuple(
    SceneSettings(k, 10, speed_m_s=v) for v, k in product((0.02, 0.05), (1e3, 5e3, 2e4))
)
BRAKES = tuple(
    SceneSettings(k, d, accel_m_s2=a)
    for a, d, k in product((1, 2, 5, 7.5), (0, 10, 30, 60), (5e3, 2e4, 2e5))
)
SLOW_PLAIN_S = 20.0
SOFTEST_PLATE_N_M = 1e3  # that the simulated cell can be given


@dataclass(frozen=True, slots=True)
class Extent:
    """Extent of a run."""

    stiffnesses_N_m: Sequence[float] = settle.STIFFNESSES_N_M
    delays_ms: Sequence[int] = settle.DELAYS_MS
    errors_ms: Sequence[float] = DELAY_ERRORS_MS
    scene_worlds: Sequence[SceneSettings] = SCENE_WORLDS
    search_scenes: Sequence[SceneSettings] = search.SCENES
    search_part: int = 1
    limited: Sequence[SceneSettings] = LIMITED
    brakes: Sequence[SceneSettings] = BRAKES
    over_tcp: Sequence[tcp_releases.TcpRelease] = tcp_releases.CASES


SHORT = Extent(
    scene_worlds=(SceneSettings(2e4, 10), SceneSettings(1e5, 30)),
    search_scenes=tuple(world for world in search.SCENES if world.delay_ms in {10, 30}),
)
QUICK = Extent(
    (5e3, 2e4, 1e5),
    (10, 30),
    (0.0,),
    (SceneSettings(2e4, 10),),
    (SceneSettings(5e3, 10), SceneSettings(1e5, 10)),
    5,
    LIMITED[-1:],
    BRAKES[-1:],
    tcp_releases.CASES[:1],
)


def release_rows(extent: Extent, pool: Executor) -> list[Row]:
    """Return the releases over stiffness, delay and delay error."""
    worlds = [
        SceneSettings(k, d, delay_error_ms=error)
        for error, d, k in product(extent.errors_ms, extent.delays_ms, extent.stiffnesses_N_m)
    ]
    return list(pool.map(release_row, worlds))


def slow_rows(_: Extent, pool: Executor) -> list[Row]:
    """Return the releases with a controller of low pose rate."""
    places = product(SLOW_DELAYS_MS, LOOPS_HZ, (5e3, 2e4, 1e5))
    slow = [SceneSettings(k, delay_ms, hz) for delay_ms, hz, k in places]
    return list(pool.map(release_row, slow))


def tcp_rows(extent: Extent, pool: Executor) -> list[Row]:
    """Return the releases over TCP, on both loop hosts."""
    return list(pool.map(tcp_releases.row, extent.over_tcp))


def limited_rows(extent: Extent, pool: Executor) -> list[Row]:
    """Return the releases with a lower speed limit."""
    return list(pool.map(release_row, extent.limited))


def brake_rows(extent: Extent, pool: Executor) -> list[Row]:
    """Return the releases with low braking acceleration."""
    return list(pool.map(release_row, extent.brakes))


def scene_rows(extent: Extent, pool: Executor) -> list[Row]:
    """Return every law in every scene."""
    return list(pool.map(scene_row, scene_jobs(extent)))


def release_row(world: SceneSettings) -> Row:
    """Return first contact and identified stiffness, for our law."""
    first, identified = settle.ours(world)
    row: Row = {
        "stiffness_N_m": world.stiffness_N_m,
        "delay_ms": world.delay_ms,
        "loop_hz": world.loop_hz,
        "speed_m_s": world.speed_m_s,
        "accel_m_s2": world.accel_m_s2,
        "delay_error_ms": world.delay_error_ms,
        "tau_s": first.tau_s,
        "stiffness_ratio": identified.stiffness_ratio,
    }
    for name, done in (("first", first), ("identified", identified)):
        row |= {f"{name}_s": done.settling_s, f"{name}_overshoot_pct": done.overshoot_pct}
    return row


def fixed_gain_rows(_: Extent, __: Executor) -> list[Row]:
    """Return the settling of a PI law safe at 1e5 N/m and of ours, at 5e3 N/m."""
    world = SceneSettings(5e3, 10)
    tau_s = settle.true_tau_s(world)
    fixed: Release = settle.plain(world, 0.45 / (1e5 * tau_s), SLOW_PLAIN_S)
    identified = settle.ours(world)[1]
    return [{"fixed_s": fixed.settling_s, "identified_s": identified.settling_s}]


def peer_rows(extent: Extent, pool: Executor) -> list[Row]:
    """Return the results of the search for each peer, scene by scene."""
    rows = []
    for law in search.LAWS:
        found = search.tuned(law, extent.search_scenes, pool, extent.search_part)
        for number, world in enumerate(extent.search_scenes):
            rows.append(
                {
                    "law": law,
                    "stiffness_N_m": world.stiffness_N_m,
                    "delay_ms": world.delay_ms,
                    "one_setting": asdict(found.one),
                    "one_s": _settled(found.one_s[number]),
                    "tuned_here": asdict(found.each[number]),
                    "tuned_here_s": _settled(found.each_s[number]),
                }
            )
    return rows


def _settled(seconds: float) -> float | None:
    return None if seconds >= search.NOT_SETTLED_S else float(seconds)


def scene_jobs(extent: Extent) -> list[tuple[str, str, SceneSettings]]:
    """Return every combination of scene, law and world."""
    jobs = [
        (scene, law, world)
        for scene, law, world in product(scenes.SCENES, LAWS, extent.scene_worlds)
        if scene != "ten times stiffer" or world.stiffness_N_m >= 10.0 * SOFTEST_PLATE_N_M
    ]
    jobs += [(scene, HAND_GUIDING, world) for scene, world in product(GUIDED, extent.scene_worlds)]
    slow_wall = ("wall vanishes", "adaptive")
    worlds = [replace(world, speed_m_s=v) for v in (0.02, 0.05) for world in extent.scene_worlds]
    return jobs + [(*slow_wall, world) for world in worlds]


def scene_row(job: tuple[str, str, SceneSettings]) -> Row:
    """Return the measures of one law in one scene."""
    scene, law, world = job
    row: Row = {
        "scene": scene,
        "law": law,
        "stiffness_N_m": world.stiffness_N_m,
        "delay_ms": world.delay_ms,
        "speed_m_s": world.speed_m_s,
    }
    make = stage.guided if law == HAND_GUIDING else LAWS[law]
    measures = scenes.SCENES[scene](world, make)
    return row | {name: None if np.isnan(value) else value for name, value in measures.items()}


TABLES: dict[str, Callable[[Extent, Executor], list[Row]]] = {
    "release": release_rows,
    "slow loops": slow_rows,
    "over TCP": tcp_rows,
    "limited speed": limited_rows,
    "slow brakes": brake_rows,
    "fixed gain": fixed_gain_rows,
    "scenes": scene_rows,
    "peers": peer_rows,
}
