"""Demo: refusals before any start, the law that its table names, an arbiter that seems silent."""

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.demo import scenario
from cli.demo.cell import DemoOverrides, check_plan, demo_cell, surface_of
from cli.demo.measures import measure, table
from cli.demo.scenario import SILENT_READINGS, Scenario, ScenarioPlan
from common.config.load import dump_cell, load_cell
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.errors import ConfigError
from forcemesh.faults import refusal
from forcemesh.messages import ArbiterStatus
from forcemesh.reader import Reader, Reading
from forcemesh.requests import Reply
from forcemesh.topics import Request
from launch.virtual_cell import VirtualCell
from tests.fakes.bench import DEMO
from tests.fakes.long import long
from tuning.gain_rule import tune


def test_a_curved_surface_is_refused_before_anything_starts(tmp_path: Path) -> None:
    """The distances of the demo are those from a plane."""
    path = tmp_path / "cell.yaml"
    path.write_text(dump_cell(load_cell(DEMO, {"sim.surface": "hemisphere"})), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"sim\.surface is hemisphere, set plane"):
        demo_cell(path, DemoOverrides())


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
        DemoOverrides(law="adaptive", delay_s=0.13), ScenarioPlan(press_N=10.0, settled_for_s=0.2)
    )
    assert "law plain" in title
    assert "the plain law runs in its place" in title


def test_a_set_point_that_the_mode_does_not_hold_is_refused() -> None:
    """Mode orientation regulates no force, so a force set point is refused."""
    cell = demo_cell(DEMO, DemoOverrides())
    with pytest.raises(ConfigError, match="holds no force"):
        check_plan(cell, ScenarioPlan(mode="orientation", setpoint_N=5.0))
    check_plan(cell, ScenarioPlan(mode="orientation"))


class SilentReader:
    """A reader that finds its topic silent at some readings, though its publisher is well."""

    def __init__(self, reader: Reader[ArbiterStatus], readings: int) -> None:
        """Silence begins after some readings."""
        self._reader, self._readings = reader, iter(range(20 + readings))

    def read(self, now_ns: int) -> Reading[ArbiterStatus]:
        """Return the reading, silent or not."""
        reading = self._reader.read(now_ns)
        if next(self._readings, 0) < 20:
            return reading
        return reading._replace(fault="arbiter/status stale: 540 ms old", silent=True)


@pytest.mark.parametrize("readings", [long(1), SILENT_READINGS, SILENT_READINGS + 1])
def test_a_demo_that_did_not_run_itself_does_not_call_the_arbiter_silent(readings: int) -> None:
    """Found: during other work the demo ended with `the arbiter is silent`, and the arm was well.

    Messages that came while it did not run are delivered after its first readings.
    """
    world = VirtualCell(demo_cell(DEMO, DemoOverrides()))
    plan = ScenarioPlan(press_N=10.0, settled_for_s=0.2)
    run = Scenario(world.client, plan, check=lambda: None, progress=lambda *_: None)
    run._until_ready()
    run._arbiter = SilentReader(run._arbiter, readings)  # type: ignore[assignment]
    if readings <= SILENT_READINGS:
        assert run.run().settled_at_s is not None
        return
    with pytest.raises(scenario.ScenarioError, match="540 ms old"):
        run.run()


@pytest.mark.parametrize("refusals", [2, long(1_000_000)])
def test_a_request_that_came_too_early_is_repeated(
    monkeypatch: pytest.MonkeyPatch, refusals: int
) -> None:
    """Found: during other work a tare was refused with `repeat the request`: the demo ended."""
    world = VirtualCell(demo_cell(DEMO, DemoOverrides()))
    plan = ScenarioPlan(press_N=10.0, settled_for_s=0.2)
    ask, left = Bus.ask, iter(range(refusals))

    def early(bus: Bus, request: Request[Any], message: Any) -> Reply:
        if request is topics.TARE and next(left, None) is not None:
            return refusal("wait", "not enough samples yet: repeat the request")
        return ask(bus, request, message)

    monkeypatch.setattr(Bus, "ask", early)
    run = Scenario(world.client, plan, check=lambda: None, progress=lambda *_: None)
    if refusals == 2:
        assert run.run().settled_at_s is not None
        return
    with pytest.raises(scenario.ScenarioError, match="repeat the request"):
        run.run()
