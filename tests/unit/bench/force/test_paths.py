"""Path with force in the benchmark: its path is the regulator's, and one promised point."""

import numpy as np
import pytest

from bench.force.laws import law_of
from bench.force.paths import (
    LENGTH_M,
    MEAN_N,
    PROMISED,
    WORST_SHARE,
    OnPath,
    measures,
    programmed,
)
from bench.force.rig import ForceRig, SceneSettings

WORLD = SceneSettings(PROMISED["stiffness_N_m"], 10, PROMISED["loop_hz"])


@pytest.mark.parametrize("most_rad_s", [0.2, 0.5])
def test_the_tool_turns_no_faster_than_in_the_regulator(most_rad_s: float) -> None:
    """The limit is that of the cell, not one of the benchmark's own."""
    rig = ForceRig(SceneSettings(overrides={"force.speed_max_rad_s": most_rad_s}).cell())
    assert OnPath(law_of("adaptive", rig), rig).path.curve.turns.rad_s == most_rad_s


@pytest.mark.parametrize("surface", ["plane", "cylinder", "hemisphere"])
def test_the_program_leads_out_and_back_and_is_off(surface: str) -> None:
    """Its first pose is a millimetre off along each axis, its last one is the first."""
    rig = ForceRig(WORLD.cell())
    poses = [*programmed(rig, surface)]
    away_m = poses[0].translation - rig.arm.plate.point_m
    assert away_m == pytest.approx([0.001, 0.001, 0.001], abs=1e-9)
    assert poses[-1].isApprox(poses[0], 1e-9)
    place_m = np.array([T.translation for T in poses])
    length_m = float(np.linalg.norm(np.diff(place_m, axis=0), axis=1).sum())
    assert length_m == pytest.approx(2.0 * LENGTH_M, rel=0.01)


def test_the_promise_is_met_on_the_cylinder() -> None:
    """At the promised speed, stiffness and rate of the loop."""
    found = measures(PROMISED, "cylinder")
    assert found["mean_error_N"] <= MEAN_N
    assert found["worst_press_share"] <= WORST_SHARE
