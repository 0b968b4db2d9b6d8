"""The main job, in lock step on the virtual clock: every stiffness, delay, mode and loop host.

Over TCP it passes the real gateway and the shipped program; `make bench ARGS=over-tcp` runs every
combination, these are its extremes.
"""

from pathlib import Path
from typing import Any

import pytest

from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell, surface_of
from cli.demo.measures import Result, measure
from cli.demo.scenario import ScenarioError, ScenarioPlan, play_virtual
from common.config.load import load_cell
from control.gain_rule import tune
from forcemesh.errors import ConfigError
from tests.fakes.bench import DEMO
from tests.fakes.long import long

OVER_TCP = DEMO.with_name("demo-tcp.yaml")
MODES = ("position", "orientation", "both")
MOST_OVERSHOOT_PCT = 5.0


def run_demo(
    mode: Any, stiffness_N_m: float, *, path: Path = DEMO, host: Any = "pc", **changes: Any
) -> Result:
    """Run the demo's script with the documented gain rule and return its numbers."""
    trial = {"tilt_deg": DEFAULT_TILT_DEG[mode], "stiffness_N_m": stiffness_N_m} | changes
    cell = demo_cell(path, DemoOverrides(**trial))
    plan = ScenarioPlan(mode=mode, host=host, setpoint_N=DEFAULT_SETPOINT_N[mode])
    trace = play_virtual(cell, plan, lambda *_: None)
    return measure(trace, plan, surface_of(cell), tune(cell).tau_s)


@pytest.mark.parametrize("delay_ms", [0, long(10), 30])
@pytest.mark.parametrize("stiffness_N_m", [5e3, long(2e4), 1e5])
@pytest.mark.parametrize("mode", MODES)
def test_the_main_job_settles_without_overshoot(mode, stiffness_N_m, delay_ms):
    """From 30 N, tool exactly down (A = 180), the tuned gain settles with at most 5 %."""
    result = run_demo(mode, stiffness_N_m, delay_s=delay_ms / 1e3)
    assert result.settled
    assert result.overshoot_pct <= MOST_OVERSHOOT_PCT


@pytest.mark.parametrize("stiffness_N_m", [long(5e3), 2e4, long(1e5)])
@pytest.mark.parametrize("mode", MODES)
def test_the_main_job_settles_on_a_plate_tilted_15_degrees(mode, stiffness_N_m):
    """The disc meets it with its edge first; pressed and free to rotate it ends flat on it."""
    result = run_demo(mode, stiffness_N_m, delay_s=0.01, tilt_deg=15.0)
    assert result.settled
    assert result.overshoot_pct <= MOST_OVERSHOOT_PCT
    if (mode, stiffness_N_m) == ("both", 2e4):
        assert result.misalignment_deg <= 0.2
        assert result.final_force_N == pytest.approx(10.0, abs=1.0)


@pytest.mark.parametrize("delay_ms", [0, long(10), 30])
@pytest.mark.parametrize("stiffness_N_m", [2e4, long(1e5)])
def test_settling_is_proportional_to_tau(stiffness_N_m, delay_ms):
    """Where stiffness and delay limit the gain, 30 N to 1 N takes a few tau, not more."""
    result = run_demo("position", stiffness_N_m, delay_s=delay_ms / 1e3)
    assert result.settling_s is not None
    assert 4.0 * result.tau_s <= result.settling_s <= 8.0 * result.tau_s


def test_a_gain_for_a_plate_ten_times_softer_is_stopped_by_the_force_ceiling():
    """The measure can fail: a gain that is far too high does not settle, and the arm is held."""
    cell = demo_cell(DEMO, DemoOverrides(stiffness_N_m=1e5, delay_s=0.01))
    softer = cell.contact.model_copy(update={"stiffness_N_m": 1e4})
    cell = cell.model_copy(update={"contact": softer})
    with pytest.raises(ScenarioError, match="above the ceiling"):
        play_virtual(cell, ScenarioPlan(), lambda *_: None)


@pytest.mark.parametrize(
    ("stiffness_N_m", "as_step_s", "pessimistic"),
    [(5e3, 0.0003, False), (1e5, 0.000125, True)],
    ids=["soft and slow", "stiff and pessimistic"],
)
@pytest.mark.parametrize("mode", [long("position"), long("orientation"), "both"])
@pytest.mark.parametrize("host", ["pc", "controller"])
def test_the_main_job_settles_over_tcp(host, mode, stiffness_N_m, as_step_s, pessimistic):
    """On either loop host: gateway, packets, AS program, motion of the arm, and back."""
    result = run_demo(
        mode, stiffness_N_m, path=OVER_TCP, host=host, as_step_s=as_step_s, pessimistic=pessimistic
    )
    assert result.settled
    assert result.overshoot_pct <= MOST_OVERSHOOT_PCT


def test_a_step_time_for_a_cell_without_an_emulated_controller_is_refused():
    """The message names a cell that has one."""
    with pytest.raises(ConfigError, match=r"demo-tcp\.yaml"):
        demo_cell(DEMO, DemoOverrides(as_step_s=0.0003))


def test_delay_and_rate_are_proportional_to_the_step_time():
    """All parts of the loop in the program; a measurement at one step time holds for another."""
    plain = load_cell(OVER_TCP)
    assert plain.sim is not None
    slow = demo_cell(OVER_TCP, DemoOverrides(as_step_s=2.0 * plain.sim.as_step_s))
    assert slow.robot.delay_s == pytest.approx(2.0 * plain.robot.delay_s)
    assert slow.rates.robot_hz == pytest.approx(0.5 * plain.rates.robot_hz)


@pytest.mark.parametrize(("segment_s", "longer_s"), [(0.016, 0.0), (0.03, 0.0), (0.06, 0.09)])
def test_longer_segments_are_a_longer_delay(segment_s, longer_s):
    """Three times as much; shorter ones are limited by the program. Gateway and emulator agree."""
    cell = demo_cell(OVER_TCP, DemoOverrides(least_segment_s=segment_s))
    assert cell.robot.delay_s == pytest.approx(load_cell(OVER_TCP).robot.delay_s + longer_s)
    assert cell.gateway is not None
    assert cell.sim is not None
    assert cell.gateway.least_segment_s == cell.sim.as_least_segment_s == segment_s
