"""The main job, in lock step on the virtual clock: every stiffness, delay and mode."""

from pathlib import Path

import pytest

from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell, surface_of
from cli.demo.measures import Result, measure
from cli.demo.scenario import ScenarioError, ScenarioPlan, play_virtual
from tests.fakes.long import long
from tuning.gain_rule import tune

CELL = Path(__file__).parents[2] / "cells" / "demo.yaml"
MODES = ("position", "orientation", "both")
MOST_OVERSHOOT_PCT = 5.0


def run_demo(mode, stiffness_N_m, *, delay_ms, tilt_deg=None, press_N=30.0) -> Result:
    """Run the demo's script with the documented gain rule and return its numbers."""
    cell = demo_cell(
        CELL,
        DemoOverrides(
            tilt_deg=DEFAULT_TILT_DEG[mode] if tilt_deg is None else tilt_deg,
            stiffness_N_m=stiffness_N_m,
            delay_s=delay_ms / 1e3,
        ),
    )
    plan = ScenarioPlan(mode=mode, press_N=press_N, setpoint_N=DEFAULT_SETPOINT_N[mode])
    trace = play_virtual(cell, plan, lambda *_: None)
    return measure(trace, plan, surface_of(cell), tune(cell).tau_s)


@pytest.mark.parametrize("delay_ms", [0, long(10), 30])
@pytest.mark.parametrize("stiffness_N_m", [5e3, long(2e4), 1e5])
@pytest.mark.parametrize("mode", MODES)
def test_the_main_job_settles_without_overshoot(mode, stiffness_N_m, delay_ms):
    """From 30 N, tool exactly down (A = 180), the tuned gain settles with at most 5 %."""
    result = run_demo(mode, stiffness_N_m, delay_ms=delay_ms)

    assert result.settled
    assert result.overshoot_pct <= MOST_OVERSHOOT_PCT


@pytest.mark.parametrize("stiffness_N_m", [long(5e3), 2e4, long(1e5)])
@pytest.mark.parametrize("mode", MODES)
def test_the_main_job_settles_on_a_plate_tilted_15_degrees(mode, stiffness_N_m):
    """The same from a plate that the disc meets with its edge first."""
    result = run_demo(mode, stiffness_N_m, delay_ms=10, tilt_deg=15.0)

    assert result.settled
    assert result.overshoot_pct <= MOST_OVERSHOOT_PCT
    if (mode, stiffness_N_m) == ("both", 2e4):
        is_parallel_to_plate(result)


@pytest.mark.parametrize("delay_ms", [0, long(10), 30])
@pytest.mark.parametrize("stiffness_N_m", [2e4, long(1e5)])
def test_settling_is_proportional_to_tau(stiffness_N_m, delay_ms):
    """Where stiffness and delay limit the gain, 30 N to 1 N takes a few tau, not more."""
    result = run_demo("position", stiffness_N_m, delay_ms=delay_ms)

    assert result.settling_s is not None
    assert 4.0 * result.tau_s <= result.settling_s <= 8.0 * result.tau_s


def is_parallel_to_plate(result: Result) -> None:
    """Return whether the tool's face ended parallel to the plate, pressed and free to rotate."""
    assert result.misalignment_deg <= 0.2
    assert result.final_force_N == pytest.approx(10.0, abs=1.0)


def test_a_gain_for_a_plate_ten_times_softer_is_stopped_by_the_force_ceiling():
    """The measure can fail: a gain that is far too high does not settle, and the arm is held."""
    cell = demo_cell(CELL, DemoOverrides(stiffness_N_m=1e5, delay_s=0.01))
    softer = cell.contact.model_copy(update={"stiffness_N_m": 1e4})
    cell = cell.model_copy(update={"contact": softer})

    with pytest.raises(ScenarioError, match="above the ceiling"):
        play_virtual(cell, ScenarioPlan(), lambda *_: None)
