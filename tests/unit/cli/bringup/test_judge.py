"""Commands of a step, run in this process, and the judgement of what they gave."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from cli.bringup.judge import (
    CopiedStream,
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


def test_a_command_gets_the_cell_file_and_its_output_is_shown_and_kept(
    cell_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A path may have blanks; what is printed before and after the command is not kept."""
    words: list[str] = []

    def run(given: list[str]) -> None:
        words.extend(given)
        ending(3, "done\n", "why\n")(given)

    done = run_command("tune --write 'a b.yaml'", cell_file, run)
    assert words == ["tune", "--write", "a b.yaml", "--cell", str(cell_file)]
    assert (done.code, done.last_line) == (3, "why")
    assert capsys.readouterr() == ("done\n", "why\n")


def test_a_report_is_kept_and_not_shown(
    cell_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A command that ends with an error before its report has none; without one none passes."""
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


def test_a_stream_without_a_terminal_is_none() -> None:
    """Progress bars ask for it."""
    stream = CopiedStream(None)
    stream.flush()
    assert not stream.isatty()
    assert Outcome("x", 0, stream.kept).last_line == ""


def test_the_error_of_the_command_that_failed_is_the_reason(cell_file: Path) -> None:
    """Without the codes of the terminal."""
    assert by_exit_code(cell_file, [Outcome("tare", 0, "tared\n")]) == Judgement()
    why = by_exit_code(cell_file, [Outcome("tare", 0, "tared\n"), FAILED]).why
    assert why == "`forcemesh tune`: refused (busy): stop that first, exit code 1"
    for judge in (judge_doctor, judge_installation, judge_probe, judge_calibration, judge_tuning):
        assert judge(cell_file, [FAILED]).why == by_exit_code(cell_file, [FAILED]).why


def lines(*rows: tuple[str, str, str]) -> list[Outcome]:
    """Return a report of the doctor."""
    report = [{"check": c, "result": r, "found": f, "remedy": "do it"} for c, r, f in rows]
    return [Outcome("doctor --json", 1, "", {"lines": report})]


def test_the_doctor_fails_with_every_failed_check(cell_file: Path) -> None:
    """But the calibration, which comes later; the monitor speed is kept."""
    found = lines(
        ("calibration", "FAIL", "none"), ("peer", "WARN", "any"), ("mode", "FAIL", "TEACH"),
        ("monitor speed", "FAIL", "12.5 %; robot.delay_s was measured at 25 %"),
    )  # fmt: skip
    judged = judge_doctor(cell_file, found)
    assert judged.why.startswith("mode: TEACH -> do it; monitor speed: 12.5 %")
    assert judged.numbers == {"monitor_speed_percent": 12.5}
    good = lines(("calibration", "FAIL", "none"), ("monitor speed", "WARN", "unknown"))
    assert judge_doctor(cell_file, good) == Judgement()


def test_the_installation_fails_with_its_findings(cell_file: Path) -> None:
    """Each with its correction; the evidence is kept."""
    report: dict[str, Any] = {"verdict": "right", "source": "six poses", "findings": [],
                              "not_shown": [], "evidence": {"mass_kg": 1.00042}}  # fmt: skip
    assert judge_installation(cell_file, [Outcome("check axes", 0, "", report)]) == Judgement(
        "", {"mass_kg": 1.0}
    )
    wrong = report | {"findings": [{"text": "the tool weighs 1 kg", "remedy": "write it"}]}
    judged = judge_installation(cell_file, [Outcome("check axes", 1, "", wrong)])
    assert judged.why == "the tool weighs 1 kg -> write it"
    unclear = report | {"verdict": "cannot tell", "not_shown": ["the sign of fz", "the mass"]}
    judged = judge_installation(cell_file, [Outcome("check axes", 1, "", unclear)])
    assert judged.why == "cannot tell: the sign of fz; the mass"


def test_a_press_keeps_its_numbers(cell_file: Path) -> None:
    """Also when the arm was not free afterwards."""
    done = [Outcome("press 5 --json", 0, "", PRESS), Outcome("retract", 1, "held\n")]
    judged = judge_press(cell_file, done)
    assert judged.numbers["mean_N"] == 4.988
    assert judged.why == "`forcemesh retract`: held, exit code 1"
    assert judge_press(cell_file, [FAILED]).numbers == {}


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
