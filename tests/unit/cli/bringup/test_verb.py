"""`forcemesh bringup`: what it asks, runs, keeps, and where it continues."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml
from typer import Abort

from cli.bringup import judge, needs, steps
from cli.bringup.judge import Judgement, Outcome
from cli.bringup.needs import RunningCell, Situation
from cli.bringup.steps import BringupStep
from cli.context import INTERRUPTED, NOT_WELL, OK, REFUSED, USAGE
from common.config.evidence import evidence_file, read_evidence
from common.config.load import cell_hash, dump_cell, load_cell
from tests.fakes.verb_calls import run
from tools.tree import ROOT

RUN_COMMAND = judge.run_command


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


def kept(_file: Path, outcomes: Sequence[Outcome]) -> Judgement:
    """Keep a number."""
    return Judgement(judge.by_exit_code(_file, outcomes).why, {"delay_s": 0.1})


LADDER = (
    BringupStep("network", ("gateway.host",), question="is {host} there?", remedy="cable"),
    BringupStep("probe", ("gateway", "probe"), ("probe --out {probe}{yes}",), judge=kept,
                remedy="refusals", needs=(needs.cell_down,), moves=True),
    BringupStep("tune", ("robot",), ("arm", "tune"), "did it move?", remedy="by hand",
                needs=(needs.cell_up,)),
    BringupStep("press", ("robot",), ("press 5",), needs=(needs.cell_up,), at_measured_speed=True,
                moves=True),
)  # fmt: skip


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    """A short ladder, and a cell with a controller."""
    path = tmp_path / "lab.yaml"
    path.write_text(dump_cell(load_cell(ROOT / "cells" / "demo-tcp.yaml")))
    made = Lab(path)
    monkeypatch.setattr(steps, "STEPS", LADDER)
    monkeypatch.setattr(steps, "BY_NAME", {step.name: step for step in LADDER})
    monkeypatch.setattr(judge, "run_command", made.command)
    monkeypatch.setattr(needs, "situation_of", made.situation)
    return made


def states(lab: Lab) -> list[str]:
    """Return what is shown of each step."""
    done = run("bringup", "--status", "--cell", lab.file)
    return [line.split()[3] for line in done.stdout.splitlines() if line[2:4].strip().isdigit()]


def test_it_continues_where_it_stopped(lab: Lab) -> None:
    """A step that needs the running cell fails with the command that starts it."""
    done = run("bringup", "--cell", lab.file, text="y\ny\n")
    assert done.exit_code == NOT_WELL
    assert "is 127.0.0.1 there?" in done.output
    assert "hand at the emergency stop" in done.output
    assert f"FAIL tune: the cell is not up: `forcemesh up --cell {lab.file}`" in done.output
    assert lab.ran == [f"probe --out {lab.file.parent / 'probe.yaml'}"]
    assert states(lab) == ["passed", "passed", "failed", "open"]
    lab.is_up, lab.ran = True, []
    done = run("bringup", "--cell", lab.file, text="y\ny\ny\n")
    assert (done.exit_code, lab.ran) == (OK, ["arm", "tune", "press 5"])
    assert "all steps have passed" in done.output
    assert read_evidence(lab.file).steps["probe"].numbers == {"delay_s": 0.1}
    assert run("bringup", "--status", "--cell", lab.file).exit_code == OK
    assert run("bringup", "--cell", lab.file).exit_code == OK


def test_without_a_yes_nothing_is_run(lab: Lab) -> None:
    """A step of a person alone is then failed, with its remedy."""
    done = run("bringup", "--cell", lab.file, text="n\n")
    assert done.exit_code == NOT_WELL
    assert "FAIL network: not confirmed -> cable" in done.output
    done = run("bringup", "--cell", lab.file, text="y\nn\n")
    assert (done.exit_code, lab.ran) == (REFUSED, [])
    assert states(lab) == ["passed", "open", "open", "open"]


def test_a_command_that_fails_ends_its_step(lab: Lab) -> None:
    """Its error and the remedy are kept; the question after it is not asked."""
    lab.is_up, lab.codes = True, {"arm": 3}
    lab.file.with_name("lab.bringup.yaml").write_text(
        "steps:\n" + "".join(f"  {n}: {{passed_at: 2026-11-27}}\n" for n in ("network", "probe"))
    )
    done = run("bringup", "--cell", lab.file, text="y\n")
    assert (done.exit_code, lab.ran) == (NOT_WELL, ["arm"])
    why = "`forcemesh arm`: arm has ended, exit code 3 -> by hand"
    assert read_evidence(lab.file).steps["tune"].why == why
    lab.codes = {}
    done = run("bringup", "--cell", lab.file, text="y\nn\n")
    assert "FAIL tune: not confirmed -> by hand" in done.output
    lab.codes = {"press": 1}
    done = run("bringup", "--cell", lab.file, text="y\ny\ny\n")
    assert done.output.splitlines()[-1].endswith("press has ended, exit code 1")


def test_yes_is_for_a_simulated_cell_only(lab: Lab) -> None:
    """The verbs get it too; the arm of a cell without the section `sim` is real."""
    done = run("bringup", "--yes", "--cell", lab.file)
    assert done.exit_code == NOT_WELL
    assert lab.ran[0].endswith("probe.yaml --yes")
    tree = yaml.safe_load(lab.file.read_text())
    del tree["sim"]
    lab.file.write_text(
        yaml.safe_dump(tree | {"roles": {"robot": "gateway", "sensor": "external"}})
    )
    done = run("bringup", "--yes", "--cell", lab.file)
    assert done.exit_code == REFUSED
    assert "the arm is real" in done.output


def test_a_press_at_a_lower_monitor_speed_than_measured_is_refused(lab: Lab) -> None:
    """With both numbers; tuning is allowed, since it measures anew."""
    (lab.file.parent / "probe.yaml").write_text(
        "robot: {delay_s: 0.1}\nresults: {mspeed: {value: 50.0}}\n"
    )
    run("bringup", "--yes", "--cell", lab.file)
    lab.is_up, lab.percent = True, 25.0
    tree = yaml.safe_load(lab.file.read_text())
    tree["robot"]["probe"] = "probe.yaml"
    lab.file.write_text(yaml.safe_dump(tree))
    done = run("bringup", "--yes", "--cell", lab.file)
    assert done.exit_code == NOT_WELL
    assert "FAIL press: monitor speed: 25 %; robot.delay_s was measured at 50 %" in done.output
    assert lab.ran[-1] == "tune"
    assert read_evidence(lab.file).steps["tune"].numbers == {"monitor_speed_percent": 25.0}
    lab.percent = 50.0
    assert run("bringup", "--yes", "--cell", lab.file).exit_code == OK


def test_a_changed_input_and_again_make_a_step_due_again(lab: Lab) -> None:
    """Later steps that do not depend on it stay passed."""
    lab.is_up = False
    run("bringup", "--yes", "--cell", lab.file)
    lab.is_up = True
    assert run("bringup", "--yes", "--cell", lab.file).exit_code == OK
    tree = yaml.safe_load(lab.file.read_text())
    tree["gateway"]["host"] = "192.168.0.2"
    lab.file.write_text(yaml.safe_dump(tree))
    assert states(lab) == ["changed", "changed", "passed", "passed"]
    lab.is_up, lab.ran = False, []
    assert run("bringup", "--yes", "--cell", lab.file).exit_code == OK
    assert len(lab.ran) == 1
    done = run("bringup", "--again", "probe", "--cell", lab.file, text="n\n")
    assert (done.exit_code, len(lab.ran)) == (REFUSED, 1)
    assert states(lab) == ["passed"] * 4
    run("bringup", "--again", "probe", "--yes", "--cell", lab.file)
    assert len(lab.ran) == 2


def test_a_step_runs_the_verbs_of_the_command_line(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process; the error of the verb is shown and kept."""
    step = BringupStep("record", ("roles",), ("record status",), remedy="recordings.md")
    monkeypatch.setattr(steps, "STEPS", (step,))
    monkeypatch.setattr(steps, "BY_NAME", {"record": step})
    monkeypatch.setattr(judge, "run_command", RUN_COMMAND)
    done = run("bringup", "--yes", "--cell", lab.file)
    assert done.exit_code == NOT_WELL
    assert "`forcemesh up` starts it" in done.stderr
    why = read_evidence(lab.file).steps["record"].why
    assert why.startswith("`forcemesh record status`: ")
    assert why.endswith("exit code 4 -> recordings.md")


def test_a_mistake_is_one_sentence(lab: Lab) -> None:
    """A step that does not exist, evidence that cannot be read."""
    done = run("bringup", "--again", "fly", "--cell", lab.file)
    assert done.exit_code == USAGE
    assert "--again fly: no such step; there are network, probe" in done.output
    evidence_file(lab.file).write_text("bringup: 2\n")
    assert run("bringup", "--cell", lab.file).exit_code == USAGE


def test_evidence_that_cannot_be_written_is_refused_before_a_step(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder without the right, a full disk: the arm would move for nothing."""

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "replace", refuse)
    done = run("bringup", "--yes", "--cell", lab.file)
    assert done.exit_code == USAGE
    assert "lab.bringup.yaml: cannot be written: Permission denied" in done.output
    assert "there?" not in done.output


def test_a_probe_that_is_missing_can_be_measured(lab: Lab) -> None:
    """Though the cell file names it already; a step that needs its values has the remedy."""
    tree = yaml.safe_load(lab.file.read_text())
    tree["robot"]["probe"] = "probe.yaml"
    lab.file.write_text(yaml.safe_dump(tree))
    lab.situation = lambda file: Situation(file, None)  # type: ignore[method-assign]
    done = run("bringup", "--cell", lab.file, text="y\ny\n")
    assert lab.ran == [f"probe --out {lab.file.parent / 'probe.yaml'}"]
    assert "FAIL tune: the cell is not up" in done.output
    done = run("config", "check", lab.file)
    assert done.exit_code == USAGE
    assert "measure it with `forcemesh probe`, or take robot.probe out" in done.output


def test_an_interruption_after_a_motion_reports_no_rest(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The question after the commands: the arm has moved; the step stays as it was."""
    lab.is_up = True
    lab.file.with_name("lab.bringup.yaml").write_text(
        "steps:\n" + "".join(f"  {n}: {{passed_at: 2026-11-27}}\n" for n in ("network", "probe"))
    )

    def interrupt(*_: object, **__: object) -> bool:
        if not lab.ran:
            return True
        error = Abort()
        error.__context__ = KeyboardInterrupt()
        raise error

    monkeypatch.setattr("cli.context.confirm", interrupt)
    done = run("bringup", "--cell", lab.file)
    assert (done.exit_code, lab.ran) == (INTERRUPTED, ["arm", "tune"])
    assert "interrupted: tune is not confirmed" in done.output
    assert "nothing was moved" not in done.output
    assert states(lab)[2] == "open"
