"""`forcemesh bringup`: what it asks, runs, judges, keeps, and where it continues."""

import json
import re
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import typer.main
import yaml
from typer import Abort

from cli.__main__ import app
from cli.bringup import judge, needs, steps
from cli.bringup.judge import (
    Judgement,
    Outcome,
    by_exit_code,
    judge_calibration,
    judge_doctor,
    judge_installation,
    judge_press,
    judge_probe,
    judge_tuning,
    run_command,
)
from cli.bringup.needs import RunningCell, Situation, cell_down, cell_up, situation_of
from cli.bringup.steps import PAGE, STEPS, BringupStep
from cli.context import INTERRUPTED, NOT_WELL, OK, REFUSED
from common.config.cell import CellConfig
from common.config.evidence import PROGRAMS, read_evidence
from common.config.load import cell_hash, dump_cell, load_cell
from forcemesh.errors import BusError
from launch.run_file import new_run
from tests.fakes.bench import DEMO
from tests.fakes.verb_calls import run
from tools.tree import ROOT

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


def test_an_interruption_after_a_motion_reports_no_rest(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The question after the commands: the arm has moved; the step stays as it was."""
    lab.run("--yes")
    lab.is_up, lab.ran = True, []
    stopped = Abort()
    stopped.__context__ = KeyboardInterrupt()
    monkeypatch.setattr("cli.context.confirm", Mock(side_effect=[True, stopped]))
    code, output = lab.run()
    assert (code, lab.ran) == (INTERRUPTED, ["arm", "tune"])
    assert "interrupted: tune is not confirmed" in output
    assert "nothing was moved" not in output
    assert lab.states()[2] == "failed"  # as before: the cell was not up


PRESS = {"setpoint_N": 5.0, "reached_s": 1.0, "mean_N": 4.98761, "ripple_N": 0.1, "peak_N": 5.4}


def ending(code: object, out: str = "", err: str = "") -> Callable[[list[str]], None]:
    """Return a command line that prints and ends."""

    def run(_words: list[str]) -> None:
        sys.stdout.write(out)
        sys.stderr.write(err)
        sys.exit(code)  # type: ignore[arg-type]

    return run


def test_the_output_of_a_command_is_shown_and_kept_or_is_a_report(
    cell_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without --json the output is shown too; with it, a command without a report has failed."""
    words: list[str] = []

    def tune(given: list[str]) -> None:
        words.extend(given)
        ending(3, "done\n", "\x1b[2Kwhy\n")(given)

    done = run_command("tune --write 'a b.yaml'", cell_file, tune)
    assert words == ["tune", "--write", "a b.yaml", "--cell", str(cell_file)]
    assert (done.code, done.last_line) == (3, "why")
    assert capsys.readouterr() == ("done\n", "\x1b[2Kwhy\n")
    assert (
        by_exit_code(cell_file, [done]).why
        == "`forcemesh tune --write 'a b.yaml'`: why, exit code 3"
    )
    done = run_command("press 5 --json", cell_file, ending(0, json.dumps(PRESS)))
    assert (done.report, capsys.readouterr().out) == (PRESS, "")
    done = run_command("press 5 --json", cell_file, ending(4, "", "no reply\n"))
    assert (done.code, done.report, done.last_line) == (4, {}, "no reply")
    assert by_exit_code(cell_file, [run_command("tare", cell_file, ending(None))]) == Judgement()
    for text in ("", "a note\n{}", "[]"):
        done = run_command("check axes --json", cell_file, ending(0, text))
        assert (done.code, done.report) == (1, {})


def lines(*rows: tuple[str, str, str]) -> Outcome:
    """Return a report of the doctor."""
    report = [{"check": c, "result": r, "found": f, "remedy": "do it"} for c, r, f in rows]
    return Outcome("doctor --json", 1, "", {"lines": report})


def axes(code: int, **changes: Any) -> Outcome:
    """Return a report of the installation."""
    report: dict[str, Any] = {
        "verdict": "right", "source": "six poses", "findings": [], "not_shown": [],
        "evidence": {"mass_kg": 1.00042},
    }  # fmt: skip
    return Outcome("check axes", code, "", report | changes)


UNCALIBRATED = ("calibration", "FAIL", "none")  # comes later
SLOW = ("monitor speed", "FAIL", "12.5 %; robot.delay_s was measured at 25 %")
LIGHT = {"text": "the tool weighs 1 kg", "remedy": "write it"}
FAILED: list[Any] = [
    (judge, Outcome("tune", 1, "busy\n"), "`forcemesh tune`: busy, exit code 1", {})
    for judge in (judge_doctor, judge_installation, judge_probe, judge_calibration, judge_tuning)
]


@pytest.mark.parametrize(
    ("judge", "outcome", "why", "numbers"),
    [
        *FAILED,
        (judge_doctor, lines(UNCALIBRATED, ("peer", "WARN", "any")), "", {}),
        (judge_doctor, lines(UNCALIBRATED, ("mode", "FAIL", "TEACH"), SLOW),
         "mode: TEACH -> do it; monitor speed: 12.5 %", {"monitor_speed_percent": 12.5}),
        (judge_installation, axes(0), "", {"mass_kg": 1.0}),
        (judge_installation, axes(1, findings=[LIGHT]), "the tool weighs 1 kg -> write it",
         {"mass_kg": 1.0}),
        (judge_installation, axes(1, verdict="cannot tell", not_shown=["the sign", "the mass"]),
         "cannot tell: the sign; the mass", {"mass_kg": 1.0}),
        (judge_press, Outcome("press 5 --json", 1, "held\n", PRESS),
         "`forcemesh press 5 --json`: held, exit code 1", PRESS | {"mean_N": 4.988}),
    ],
)  # fmt: skip
def test_a_report_gives_the_reason_with_its_remedy_and_the_numbers_to_keep(
    cell_file: Path,
    judge: Callable[[Path, list[Outcome]], Judgement],
    outcome: Outcome,
    why: str,
    numbers: dict[str, float],
) -> None:
    """Every failed check or finding is named."""
    judged = judge(cell_file, [outcome])
    assert judged.why.startswith(why)
    assert (bool(judged.why), judged.numbers) == (bool(why), numbers)


def test_probe_and_tuning_keep_what_their_files_hold(cell_file: Path) -> None:
    """Null is left out; a calibration that is not there is a failure."""
    good, folder = [Outcome("probe", 0, "")], cell_file.parent
    (folder / "probe.yaml").write_text("robot: {delay_s: 0.1}\nresults: {mspeed: {value: 10.0}}\n")
    (folder / "tuning.yaml").write_text("robot: {delay_s: 0.12345}\n")
    assert judge_probe(cell_file, good).numbers == {"delay_s": 0.1, "monitor_speed_percent": 10.0}
    assert judge_tuning(cell_file, good).numbers == {"delay_s": 0.1235}
    assert "is not there" in judge_calibration(cell_file, good).why


def test_a_cell_is_up_when_its_hub_or_its_supervisor_is(
    cell_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise its start is the remedy, and the controller's connection is free."""

    def refuse(*_: object, **_options: object) -> None:
        raise BusError("no hub")

    monkeypatch.setattr(needs, "ConfiguredCell", refuse)
    down = situation_of(cell_file)
    assert (down.running, cell_down(down)) == (None, "")
    assert f"`forcemesh up --cell {cell_file}`" in cell_up(down)
    new_run(load_cell(cell_file), cell_file).write()  # this test is the supervisor
    up = situation_of(cell_file)
    assert up.running == RunningCell("", None)
    assert "Ctrl-C" in cell_down(up)
    assert "`forcemesh status`" in cell_up(up)


def test_a_cell_with_another_file_than_the_present_one_is_to_be_restarted(cell_file: Path) -> None:
    """A step would be judged with other numbers than those of the file."""
    running = RunningCell(cell_hash(load_cell(cell_file)), None)
    assert cell_up(Situation(cell_file, running)) == ""
    tree = yaml.safe_load(cell_file.read_text())
    tree["payload"]["mass_kg"] = 1.23
    cell_file.write_text(yaml.safe_dump(tree))
    assert "has changed since the cell was started" in cell_up(Situation(cell_file, running))


def test_a_file_that_the_cell_file_does_not_name_is_missing(cell_file: Path) -> None:
    """The remedy is the line to write."""
    found, tree = Situation(cell_file, None), yaml.safe_load(cell_file.read_text())
    assert "as robot.probe: set `" in needs.probe_named(found)
    assert "as calibration: set `" in needs.calibration_named(found)
    assert "as tuning: set `" in needs.tuning_named(found)
    tree["robot"]["probe"] = tree["calibration"] = tree["tuning"] = "file.yaml"
    cell_file.write_text(yaml.safe_dump(tree))
    assert needs.probe_named(found) == needs.calibration_named(found) == ""
    assert needs.tuning_named(found) == ""


# --- steps ----------------------------------------------------------------------------------------

TEXT = (ROOT / PAGE).read_text(encoding="utf-8")
COMMANDS = sorted(set(re.findall(r"(?:`|^)forcemesh ([^`\n#]+)", TEXT, re.MULTILINE)))
FILES = ("probe", "calibration", "tuning")


def test_the_page_has_a_section_for_each_step_in_its_order() -> None:
    """With what to do, when it passes, what to do if not, and every command as it is run."""
    parts = re.split(r"\n## (\d+)\. (\w+)\n", TEXT)
    names, sections = parts[2::3], parts[3::3]
    assert list(names) == [step.name for step in STEPS]
    for step, section in zip(STEPS, sections, strict=True):
        assert all(f"- **{word}**:" in section for word in ("Do", "Pass", "If not"))
        for command in step.commands:
            plain = command.replace("{yes}", "").replace(" --json", "")
            plain = plain.format(probe="cells/probe.yaml", tuning="cells/tuning.yaml")
            assert f"forcemesh {plain}" in section
        assert ("he arm moves" in section) == step.moves
        for name in step.inputs:  # a file, or a section or field of the cell file
            is_file = name in FILES or (PROGRAMS / name).is_file()
            assert is_file or name.split(".")[0] in CellConfig.model_fields, name


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_page_has_its_options(command: str) -> None:
    """A verb of the command line, and options that it has."""
    verb: Any = typer.main.get_command(app)
    words = shlex.split(command)
    while words and words[0] in getattr(verb, "commands", {}):
        verb = verb.commands[words.pop(0)]
    assert not hasattr(verb, "commands")
    options = {option for each in verb.params for option in each.opts}
    assert {word for word in words if word.startswith("--")} <= options
