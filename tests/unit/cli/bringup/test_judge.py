"""Commands of a step, run in this process, and the judgement of what they gave."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

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
from common.config.load import dump_cell, load_cell
from tools.tree import ROOT

PRESS = {"setpoint_N": 5.0, "reached_s": 1.0, "mean_N": 4.98761, "ripple_N": 0.1, "peak_N": 5.4}
ROUNDED = PRESS | {"mean_N": 4.988}
RESIDUALS = dict.fromkeys(("force_mean_N", "force_max_N", "torque_mean_Nm", "torque_max_Nm"), 0.01)
CALIBRATION = {
    "cell": "demo-tcp", "made_at": "2026-11-27T08:00:00Z", "method": "arm",
    "T_flange_tcp": {"position_m": [0, 0, 0.16]}, "T_flange_sensor": {"position_m": [0, 0, 0.02]},
    "fit": {"poses": 10, **RESIDUALS}, "payload": {"mass_kg": 1.2, "com_m": [0, 0, 0.05]},
}  # fmt: skip
FAILED = Outcome("tune", 1, "first\n\x1b[2Krefused (busy): stop that first\n")


@pytest.fixture
def cell_file(tmp_path: Path) -> Path:
    """A cell with a controller, a probe in its folder."""
    path = tmp_path / "lab.yaml"
    tree = yaml.safe_load(dump_cell(load_cell(ROOT / "cells" / "demo-tcp.yaml")))
    path.write_text(yaml.safe_dump(tree | {"calibration": "made.yaml"}))
    return path


def ending(code: object, out: str = "", err: str = "") -> Callable[[list[str]], None]:
    """Return a command line that prints and ends."""

    def run(_words: list[str]) -> None:
        sys.stdout.write(out)
        sys.stdout.flush()
        sys.stderr.write(err)
        sys.exit(code)  # type: ignore[arg-type]

    return run


def test_the_output_of_a_command_is_shown_and_kept_or_is_a_report(
    cell_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A command that ends with an error before its report has none; without one none passes.

    Each gets the cell file; a path may have blanks; without --json the output is shown too.
    """
    words: list[str] = []

    def tune(given: list[str]) -> None:
        words.extend(given)
        ending(3, "done\n", "why\n")(given)

    done = run_command("tune --write 'a b.yaml'", cell_file, tune)
    assert words == ["tune", "--write", "a b.yaml", "--cell", str(cell_file)]
    assert (done.code, done.last_line) == (3, "why")
    assert capsys.readouterr() == ("done\n", "why\n")
    done = run_command("press 5 --json", cell_file, ending(0, json.dumps(PRESS)))
    assert done.report == PRESS
    assert capsys.readouterr().out == ""
    done = run_command("press 5 --json", cell_file, ending(4, "", "no reply\n"))
    assert (done.code, done.report, done.last_line) == (4, {}, "no reply")
    assert run_command("tare", cell_file, ending(None)).code == 0
    for text in ("", "a note\n{}", "[]"):
        done = run_command("check axes --json", cell_file, ending(0, text))
        assert (done.code, done.report) == (1, {})
        assert judge_installation(cell_file, [done]).why.endswith("no report, exit code 1")


def test_the_error_of_the_command_that_failed_is_the_reason(cell_file: Path) -> None:
    """Without the codes of the terminal."""
    assert by_exit_code(cell_file, [Outcome("tare", 0, "tared\n")]) == Judgement()
    why = by_exit_code(cell_file, [Outcome("tare", 0, "tared\n"), FAILED]).why
    assert why == "`forcemesh tune`: refused (busy): stop that first, exit code 1"
    for judge in (judge_doctor, judge_installation, judge_probe, judge_calibration, judge_tuning):
        assert judge(cell_file, [FAILED]).why == by_exit_code(cell_file, [FAILED]).why


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
NOT_SHOWN = ["the sign of fz", "the mass"]


@pytest.mark.parametrize(
    ("judge", "outcome", "why", "numbers"),
    [
        (judge_doctor, lines(UNCALIBRATED, ("peer", "WARN", "any")), "", {}),
        (judge_doctor, lines(UNCALIBRATED, ("mode", "FAIL", "TEACH"), SLOW),
         "mode: TEACH -> do it; monitor speed: 12.5 %", {"monitor_speed_percent": 12.5}),
        (judge_installation, axes(0), "", {"mass_kg": 1.0}),
        (judge_installation, axes(1, findings=[LIGHT]), "the tool weighs 1 kg -> write it", None),
        (judge_installation, axes(1, verdict="cannot tell", not_shown=NOT_SHOWN),
         "cannot tell: the sign of fz; the mass", None),
        (judge_press, Outcome("press 5 --json", 1, "held\n", PRESS),
         "`forcemesh press 5 --json`: held, exit code 1", ROUNDED),
    ],
)  # fmt: skip
def test_a_report_gives_the_reason_with_its_remedy_and_the_numbers_to_keep(
    cell_file: Path,
    judge: Callable[[Path, list[Outcome]], Judgement],
    outcome: Outcome,
    why: str,
    numbers: dict[str, float] | None,
) -> None:
    """Every failed check or finding is named."""
    judged = judge(cell_file, [outcome])
    assert judged.why.startswith(why)
    assert bool(judged.why) == bool(why)
    assert numbers is None or judged.numbers == numbers


def test_probe_calibration_and_tuning_keep_what_their_files_hold(cell_file: Path) -> None:
    """Null is left out; a calibration that is not there is a failure."""
    good, folder = [Outcome("probe", 0, "")], cell_file.parent
    (folder / "probe.yaml").write_text("robot: {delay_s: 0.1}\nresults: {mspeed: {value: 10.0}}\n")
    (folder / "tuning.yaml").write_text("robot: {delay_s: 0.12345}\n")
    assert judge_probe(cell_file, good).numbers == {"delay_s": 0.1, "monitor_speed_percent": 10.0}
    assert judge_tuning(cell_file, good).numbers == {"delay_s": 0.1235}
    assert "is not there" in judge_calibration(cell_file, good).why
    (folder / "made.yaml").write_text(yaml.safe_dump(CALIBRATION))
    assert judge_calibration(cell_file, good).numbers == {"mass_kg": 1.2}
