"""The main job through the real gateway and the shipped program, in lock step on a virtual clock.

`make bench ARGS=over-tcp` runs every combination; these are its extremes.
"""

from pathlib import Path

import pytest

from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell, surface_of
from cli.demo.measures import Result, measure
from cli.demo.scenario import ScenarioPlan, play_virtual
from common.config.load import load_cell
from forcemesh.errors import ConfigError
from tests.fakes.long import long
from tuning.gain_rule import tune

CELLS = Path(__file__).parents[2] / "cells"
MOST_OVERSHOOT_PCT = 5.0


def run_demo(host, mode, trial: DemoOverrides) -> Result:
    """Run the demo's script with the documented gain rule and return its numbers."""
    cell = demo_cell(CELLS / "demo-tcp.yaml", trial)
    plan = ScenarioPlan(mode=mode, host=host, setpoint_N=DEFAULT_SETPOINT_N[mode])
    trace = play_virtual(cell, plan, lambda *_: None)
    return measure(trace, plan, surface_of(cell), tune(cell).tau_s)


@pytest.mark.parametrize(
    ("stiffness_N_m", "as_step_s", "pessimistic"),
    [(5e3, 0.0003, False), (1e5, 0.000125, True)],
    ids=["soft and slow", "stiff and pessimistic"],
)
@pytest.mark.parametrize("mode", [long("position"), long("orientation"), "both"])
@pytest.mark.parametrize("host", ["pc", "controller"])
def test_the_main_job_settles_over_tcp(host, mode, stiffness_N_m, as_step_s, pessimistic):
    """On either loop host: gateway, packets, AS program, motion of the arm, and back."""
    trial = DemoOverrides(
        tilt_deg=DEFAULT_TILT_DEG[mode],
        stiffness_N_m=stiffness_N_m,
        as_step_s=as_step_s,
        pessimistic=pessimistic,
    )
    result = run_demo(host, mode, trial)

    assert result.settled
    assert result.overshoot_pct <= MOST_OVERSHOOT_PCT


def test_a_step_time_for_a_cell_without_an_emulated_controller_is_refused():
    """The message names a cell that has one."""
    with pytest.raises(ConfigError, match=r"demo-tcp\.yaml"):
        demo_cell(CELLS / "demo.yaml", DemoOverrides(as_step_s=0.0003))


def test_delay_and_rate_are_proportional_to_the_step_time():
    """All parts of the loop in the program; a measurement at one step time holds for another."""
    plain = load_cell(CELLS / "demo-tcp.yaml")
    assert plain.sim is not None
    slow = demo_cell(CELLS / "demo-tcp.yaml", DemoOverrides(as_step_s=2.0 * plain.sim.as_step_s))
    assert slow.robot.delay_s == pytest.approx(2.0 * plain.robot.delay_s)
    assert slow.rates.robot_hz == pytest.approx(0.5 * plain.rates.robot_hz)


@pytest.mark.parametrize(("segment_s", "longer_s"), [(0.016, 0.0), (0.03, 0.0), (0.06, 0.09)])
def test_longer_segments_are_a_longer_delay(segment_s, longer_s):
    """Three times as much; shorter ones are limited by the program. Gateway and emulator agree."""
    plain = load_cell(CELLS / "demo-tcp.yaml")
    cell = demo_cell(CELLS / "demo-tcp.yaml", DemoOverrides(least_segment_s=segment_s))
    assert cell.robot.delay_s == pytest.approx(plain.robot.delay_s + longer_s)
    assert cell.gateway is not None
    assert cell.sim is not None
    assert cell.gateway.least_segment_s == cell.sim.as_least_segment_s == segment_s
