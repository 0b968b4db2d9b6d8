"""Tasks per axis in the benchmark: what a pilot does with a task, and what the page states."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from bench.force import axis_page, axis_scenes
from bench.force.axis_page import axes_page
from bench.force.axis_scenes import GAP_M, LAWS, AxisScene, axis_row, axis_rows
from bench.force.rig import SceneSettings

WORLD = SceneSettings(2e4, 10, gap_m=GAP_M)


@pytest.mark.parametrize("law", ["adaptive", "admittance, known k"])
def test_set_points_along_three_coupled_axes_are_reached_at_once(law: str) -> None:
    """Both kinds of pilot, and the rotation that is held stays."""
    row = axis_row(AxisScene("three axes", law, WORLD, 1))
    assert row["settling_s"] < 1.0
    assert row["steady_error_N"] < 0.1
    assert row["held_deg"] < 0.2


@pytest.mark.parametrize("law", ["adaptive", "FDCC-like, known k"])
def test_a_change_of_frame_and_axes_has_no_bump(law: str, monkeypatch) -> None:
    """The frame changes at the present loads; the axis that is held then does not move."""
    monkeypatch.setattr(axis_scenes, "SETTLES_S", 2.0)
    row = axis_row(AxisScene("change of task", law, WORLD, 0))
    assert row["bump_N"] < 1.0
    assert row["held_mm"] < 0.2
    assert row["steady_error_N"] < 0.1


def test_the_set_points_are_in_the_frame_and_with_the_sign_of_the_task() -> None:
    """The tool exerts +5, -4 and +10 N along base axes, after the ramp."""
    pilot = axis_scenes.pilot_of(AxisScene("three axes", "plain, known k", WORLD, 0))
    pilot.start(axis_scenes.THREE)
    assert max(map(abs, pilot.task.force_N)) < 0.5  # from no load
    trace = pilot.rig.run(pilot, 2.0)
    exerted_N = -np.mean(trace.force_N[-50:], axis=0)
    assert exerted_N == pytest.approx([5.0, -4.0, 10.0], abs=0.5)


def test_the_slower_loops_are_for_our_law_alone(monkeypatch) -> None:
    """Every law where the loop is fast."""
    monkeypatch.setattr(axis_scenes, "axis_row", lambda s: {"law": s.law, "hz": s.world.loop_hz})
    with ThreadPoolExecutor(1) as pool:
        rows = axis_rows(pool, quick=False)
    assert {row["law"] for row in rows if row["hz"] < 250.0} == {"adaptive"}
    assert {row["law"] for row in rows if row["hz"] == 250.0} == set(LAWS)


def test_the_quick_run_has_each_law_in_each_scene(monkeypatch) -> None:
    """One bushing, one loop."""
    monkeypatch.setattr(axis_scenes, "axis_row", lambda s: {"scene": s.scene, "law": s.law})
    with ThreadPoolExecutor(1) as pool:
        rows = axis_rows(pool, quick=True)
    assert sorted((row["scene"], row["law"]) for row in rows) == sorted(
        (scene, law) for scene in axis_scenes.SCENES for law in LAWS
    )


def _row(scene: str, law: str, hz: float, k: float) -> dict:
    measures = {m: 0.01 for s, m, *_ in axis_page.PROMISES if s == scene}
    settings = {"scene": scene, "law": law, "loop_hz": hz, "stiffness_N_m": k}
    return settings | {"settling_s": 0.2, "overshoot_N": 0.0} | measures


def test_the_page_states_the_worst_and_what_is_not_met() -> None:
    """Of two bushings the worse counts; a law that does not settle has no number."""
    good = [
        _row(scene, law, hz, k)
        for scene in axis_scenes.SCENES
        for law in LAWS
        for hz in axis_scenes.LOOPS_HZ
        for k in axis_scenes.STIFFNESSES_N_M
    ]
    assert "**no**" not in axes_page(good, "the command")
    bad = _row("change of task", "adaptive", 250.0, 2e4) | {"bump_N": 1.5, "settling_s": None}
    text = axes_page([*good, bad], "the command")
    assert "| change of frame at the present loads, N | 1 | 1.5 | **no** |" in text
    assert text.count("**no**") == 1
    assert "| 250 Hz, 20000 N/m | does not |" in text


def test_a_missing_table_is_not_met() -> None:
    """Without rows nothing is promised to have been kept."""
    assert axes_page([], "the command").count("**no**") == len(axis_page.PROMISES)
