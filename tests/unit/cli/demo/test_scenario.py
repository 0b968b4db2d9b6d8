"""Demo before any start: refusals, and the law that its table names."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.demo import scenario
from cli.demo.cell import DemoOverrides, check_plan, demo_cell, surface_of
from cli.demo.measures import measure, table
from cli.demo.scenario import ScenarioPlan
from forcemesh.errors import ConfigError
from tests.fakes.bench import DEMO
from tuning.gain_rule import tune


@pytest.mark.parametrize(
    "trial", [DemoOverrides(), DemoOverrides(stiffness_N_m=1e4), DemoOverrides(delay_s=0.02)]
)
def test_the_demo_never_runs_on_a_real_arm(trial: DemoOverrides) -> None:
    """Its options for the plate do not replace the section `sim` of the cell file."""
    with pytest.raises(ConfigError, match="section `sim`"):
        demo_cell(DEMO.with_name("rs007l-real.yaml"), trial)


def test_nothing_is_started_for_a_real_arm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The verb ends as wrong usage before any process starts."""
    started: list[object] = []
    monkeypatch.setattr(scenario, "play_real", lambda *words, **_: started.append(words))
    file = str(DEMO.with_name("rs007l-real.yaml"))
    result = CliRunner().invoke(
        app, ["demo", "--cell", file, "--force", "20", "--out", str(tmp_path)]
    )
    assert result.exit_code == 2
    assert "section `sim`" in result.output
    assert not started


def played(trial: DemoOverrides, plan: ScenarioPlan) -> str:
    """Return the title of a virtual demo's table, which has no latencies."""
    cell = demo_cell(DEMO, trial)
    trace = scenario.play_virtual(cell, plan, lambda *_: None)
    result = measure(trace, plan, surface_of(cell), tune(cell).tau_s)
    assert not result.hops_us
    assert result.chain_latency_us_p99 is None
    return str(table(result, plan, trace.started).title)


@pytest.mark.long
def test_the_table_names_the_law_that_ran() -> None:
    """Outside the measured map the plain law replaces the adaptive one, and is named."""
    title = played(
        DemoOverrides(law="adaptive", delay_s=0.09), ScenarioPlan(press_N=10.0, settled_for_s=0.2)
    )
    assert "law plain" in title
    assert "the plain law runs in its place" in title


def test_a_set_point_that_the_mode_does_not_hold_is_refused() -> None:
    """Mode orientation regulates no force, so a force set point is refused."""
    cell = demo_cell(DEMO, DemoOverrides())
    with pytest.raises(ConfigError, match="holds no force"):
        check_plan(cell, ScenarioPlan(mode="orientation", setpoint_N=5.0))
    check_plan(cell, ScenarioPlan(mode="orientation"))
