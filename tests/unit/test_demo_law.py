"""The demo with the adaptive law, in lock step, and the options that choose law and axes."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.demo_cell import Trial, demo_cell, surface_of
from cli.demo_play import play_virtual
from cli.measures import measure
from cli.scenario import Plan
from services.regulator.tuning import tune

CELL = Path(__file__).parents[2] / "cells" / "demo.yaml"


@pytest.mark.parametrize("file", ["demo.yaml", "demo-tcp.yaml"])
@pytest.mark.parametrize(("stiffness_N_m", "taus"), [(5e3, 6.0), (None, 5.0), (1e5, 5.0)])
def test_the_main_job_is_done_in_five_tau_with_the_adaptive_law(file, stiffness_N_m, taus) -> None:
    """From 30 N to zero, the stiffness met while pressing; at most 5 % overshoot.

    On a soft plate it is the speed limit of force feedback that takes the time.
    """
    cell = demo_cell(CELL.parent / file, Trial(law="adaptive", stiffness_N_m=stiffness_N_m))
    plan = Plan()
    trace = play_virtual(cell, plan, lambda *_: None, 0.0)
    found = measure(trace, plan, surface_of(cell), tune(cell).tau_s)
    assert found.settling_s is not None
    assert found.settling_s <= taus * found.tau_s
    assert found.overshoot_pct <= 5.0


def test_an_axis_that_does_not_exist_is_named() -> None:
    """The verb ends before it speaks to a cell."""
    result = CliRunner().invoke(app, ["force", "start", "--axes", "x,up"])
    assert result.exit_code == 2
    assert "up" in result.output
    assert "rx" in result.output
