"""`forcemesh bringup`: what it asks, runs, keeps, and where it continues."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from cli.bringup import judge, needs, steps
from cli.bringup.judge import Outcome
from cli.bringup.needs import RunningCell, Situation
from cli.bringup.steps import BringupStep
from cli.context import NOT_WELL, OK, REFUSED
from common.config.evidence import read_evidence
from common.config.load import cell_hash, dump_cell, load_cell
from tests.fakes.bench import DEMO
from tests.fakes.verb_calls import run

LADDER = (
    BringupStep("network", ("gateway.host",), question="is {host} there?", remedy="cable"),
    BringupStep("probe", ("gateway", "probe"), ("probe --out {probe}{yes}",),
                remedy="refusals", needs=(needs.cell_down,), moves=True),
    BringupStep("tune", ("robot",), ("arm", "tune"), "did it move?", remedy="by hand",
                needs=(needs.cell_up,)),
    BringupStep("press", ("robot",), ("press 5",), needs=(needs.cell_up,), at_measured_speed=True,
                moves=True),
)  # fmt: skip


@dataclass
class Lab:
    """Scripted commands and cell: what ran, how each command ends, what the cell reports."""

    file: Path
    ran: list[str] = field(default_factory=list)
    codes: dict[str, int] = field(default_factory=dict)
    percent: float | None = None
    is_up: bool = False

    def command(self, command: str, _file: Path, _run: object) -> Outcome:
        """Run a command."""
        self.ran.append(command)
        verb = command.split(maxsplit=1)[0]
        return Outcome(command, self.codes.get(verb, 0), f"{verb} has ended\n")

    def situation(self, file: Path) -> Situation:
        """Report the cell."""
        running = RunningCell(cell_hash(load_cell(file)), self.percent) if self.is_up else None
        return Situation(file, running)

    def run(self, *words: str, text: str = "") -> tuple[int, str]:
        """Run the verb; return exit code and output."""
        done = run("bringup", *words, "--cell", self.file, text=text)
        return done.exit_code, done.output

    def states(self) -> list[str]:
        """Return what is shown of each step."""
        _, output = self.run("--status")
        return [line.split()[3] for line in output.splitlines() if line[2:4].strip().isdigit()]

    def write(self, section: str, **values: Any) -> None:
        """Change values of the cell file."""
        tree = yaml.safe_load(self.file.read_text())
        tree[section] |= values
        self.file.write_text(yaml.safe_dump(tree))


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    """A short ladder, and a cell with a controller."""
    path = tmp_path / "lab.yaml"
    path.write_text(dump_cell(load_cell(DEMO.with_name("demo-tcp.yaml"))))
    made = Lab(path)
    monkeypatch.setattr(steps, "STEPS", LADDER)
    monkeypatch.setattr(steps, "BY_NAME", {step.name: step for step in LADDER})
    monkeypatch.setattr(judge, "run_command", made.command)
    monkeypatch.setattr(needs, "situation_of", made.situation)
    return made


def test_it_continues_where_it_stopped(lab: Lab) -> None:
    """A step that needs the running cell fails with the command that starts it."""
    code, output = lab.run(text="y\ny\n")
    assert code == NOT_WELL
    assert "is 127.0.0.1 there?" in output
    assert "hand at the emergency stop" in output
    assert f"FAIL tune: the cell is not up: `forcemesh up --cell {lab.file}`" in output
    assert lab.ran == [f"probe --out {lab.file.parent / 'probe.yaml'}"]
    assert lab.states() == ["passed", "passed", "failed", "open"]
    lab.is_up, lab.ran = True, []
    code, output = lab.run(text="y\ny\ny\n")
    assert (code, lab.ran) == (OK, ["arm", "tune", "press 5"])
    assert "all steps have passed" in output
    assert (lab.run("--status")[0], lab.run()[0]) == (OK, OK)


def test_without_a_yes_nothing_is_run(lab: Lab) -> None:
    """A step of a person alone is then failed, with its remedy."""
    code, output = lab.run(text="n\n")
    assert (code, "FAIL network: not confirmed -> cable" in output) == (NOT_WELL, True)
    code, _ = lab.run(text="y\nn\n")
    assert (code, lab.ran) == (REFUSED, [])
    assert lab.states() == ["passed", "open", "open", "open"]


def test_a_command_that_fails_ends_its_step(lab: Lab) -> None:
    """Its error and the remedy are kept; the question after it is not asked."""
    lab.run("--yes")
    lab.is_up, lab.codes, lab.ran = True, {"arm": 3}, []
    code, _ = lab.run(text="y\n")
    assert (code, lab.ran) == (NOT_WELL, ["arm"])
    why = "`forcemesh arm`: arm has ended, exit code 3 -> by hand"
    assert read_evidence(lab.file).steps["tune"].why == why
    lab.codes = {"press": 1}
    _, output = lab.run(text="y\ny\ny\n")
    assert output.splitlines()[-1].endswith("press has ended, exit code 1")


def test_yes_is_for_a_simulated_cell_only(lab: Lab) -> None:
    """The verbs get it too; the arm of a cell without the section `sim` is real."""
    assert lab.run("--yes")[0] == NOT_WELL
    assert lab.ran[0].endswith("probe.yaml --yes")
    tree = yaml.safe_load(lab.file.read_text())
    del tree["sim"]
    real = tree | {"roles": {"robot": "gateway", "sensor": "external"}}
    lab.file.write_text(yaml.safe_dump(real))
    code, output = lab.run("--yes")
    assert (code, "the arm is real" in output) == (REFUSED, True)


def test_a_press_at_a_lower_monitor_speed_than_measured_is_refused(lab: Lab) -> None:
    """With both numbers; tuning is allowed, since it measures anew."""
    (lab.file.parent / "probe.yaml").write_text(
        "robot: {delay_s: 0.1}\nresults: {mspeed: {value: 50.0}}\n"
    )
    lab.run("--yes")
    lab.is_up, lab.percent = True, 25.0
    lab.write("robot", probe="probe.yaml")
    code, output = lab.run("--yes")
    assert code == NOT_WELL
    assert "FAIL press: monitor speed: 25 %; robot.delay_s was measured at 50 %" in output
    assert lab.ran[-1] == "tune"
    assert read_evidence(lab.file).steps["tune"].numbers == {"monitor_speed_percent": 25.0}
    lab.percent = 50.0
    assert lab.run("--yes")[0] == OK


def test_a_changed_input_and_again_make_a_step_due_again(lab: Lab) -> None:
    """Later steps that do not depend on it stay passed."""
    lab.run("--yes")
    lab.is_up = True
    assert lab.run("--yes")[0] == OK
    lab.write("gateway", host="192.168.0.2")
    assert lab.states() == ["changed", "changed", "passed", "passed"]
    lab.is_up, lab.ran = False, []
    assert (lab.run("--yes")[0], len(lab.ran)) == (OK, 1)
    assert (lab.run("--again", "probe", text="n\n")[0], len(lab.ran)) == (REFUSED, 1)
    assert lab.states() == ["passed"] * 4
    lab.run("--again", "probe", "--yes")
    assert len(lab.ran) == 2
