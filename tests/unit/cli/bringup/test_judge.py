"""Steps of the bring-up: commands and their judgement, conditions, and the page of the table."""

import json
import re
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer.main
import yaml

from cli.__main__ import app
from cli.bringup import needs
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
from cli.bringup.needs import (
    RunningCell,
    Situation,
    cell_down,
    cell_up,
    situation_of,
)
from cli.bringup.steps import PAGE, STEPS
from common.config.cell import CellConfig
from common.config.evidence import PROGRAMS
from common.config.load import cell_hash, load_cell
from forcemesh.errors import BusError
from launch.run_file import new_run, write_run
from tools.tree import ROOT

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
    write_run(new_run(load_cell(cell_file), cell_file))  # this test is the supervisor
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
