"""Judgement of the commands of a step: why it failed, with remedy, and the numbers it gave."""

import contextlib
import io
import json
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from typer import echo

from cli.context import NOT_WELL, OK
from cli.doctor.checks import ReportLine
from cli.doctor.verb import print_lines
from common.config.calibration import CalibrationSection
from common.config.evidence import MONITOR_SPEED, named_files
from common.config.load import load_cell
from common.config.probe import ProbeFile
from forcemesh.yaml_file import read_model, read_yaml

ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")  # of a terminal's colours and progress bars
LATER = ("calibration",)  # checks of the doctor that a later step makes pass
OF_A_PRESS = ("setpoint_N", "reached_s", "mean_N", "ripple_N", "peak_N")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one command; `text` is what it printed."""

    command: str
    code: int
    text: str
    report: dict[str, Any] = field(default_factory=dict)  # of --json

    @property
    def last_line(self) -> str:
        """Return the last line that was printed: an error has one, with its remedy."""
        lines = [line.strip() for line in re.split(r"[\r\n]+", ESCAPES.sub("", self.text))]
        return next((line for line in reversed(lines) if line), "")


@dataclass(frozen=True, slots=True)
class Judgement:
    """Why the step failed, empty if it passed, and its numbers, units in the names."""

    why: str = ""
    numbers: dict[str, float] = field(default_factory=dict)


Judge = Callable[[Path, Sequence[Outcome]], Judgement]
RunCommand = Callable[[list[str]], None]  # ends with SystemExit, as the command line does


class CopiedStream(io.TextIOBase):
    """Text stream that keeps a copy of what it passes on."""

    def __init__(self, shown: TextIO | None) -> None:
        """Pass on to a stream, or to none."""
        self._shown, self._kept = shown, io.StringIO()

    def write(self, text: str) -> int:
        """Write and keep a text."""
        self._kept.write(text)
        if self._shown is not None:
            self._shown.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush the stream that is shown."""
        if self._shown is not None:
            self._shown.flush()

    def isatty(self) -> bool:
        """Return whether a terminal shows it."""
        return self._shown is not None and self._shown.isatty()

    @property
    def kept(self) -> str:
        """Everything that was written."""
        return self._kept.getvalue()


def run_command(command: str, cell_file: Path, run: RunCommand) -> Outcome:
    """Run a verb in this process, as the command line does; keep what it prints.

    The report of --json is not shown: its judge prints it.
    """
    words = [*shlex.split(command), "--cell", str(cell_file)]
    as_json = "--json" in words
    out, err = CopiedStream(None if as_json else sys.stdout), CopiedStream(sys.stderr)
    code: Any = OK
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            run(words)
        except SystemExit as end:
            code = end.code
    code, text = code if isinstance(code, int) else OK, out.kept + err.kept
    if not as_json:
        return Outcome(command, code, text)
    report = _report_in(out.kept)
    if not report and code == OK:  # nothing to judge: the step must not pass
        return Outcome(command, NOT_WELL, f"{text}\nno report")
    return Outcome(command, code, text, report)


def _report_in(text: str) -> dict[str, Any]:
    """Return the report of --json, empty without one."""
    try:
        report = json.loads(text)
    except ValueError:
        return {}
    return report if isinstance(report, dict) else {}


# --- judges ---------------------------------------------------------------------------------------


def by_exit_code(_cell_file: Path, outcomes: Sequence[Outcome]) -> Judgement:
    """Fail with the error of the command that failed."""
    failed = next((each for each in outcomes if each.code != OK), None)
    if failed is None:
        return Judgement()
    return Judgement(f"`forcemesh {failed.command}`: {failed.last_line}, exit code {failed.code}")


def judge_doctor(cell_file: Path, outcomes: Sequence[Outcome]) -> Judgement:
    """Fail with every check that failed, but those that a later step makes pass."""
    lines = [ReportLine(**row) for row in outcomes[0].report.get("lines", ())]
    if not lines:
        return by_exit_code(cell_file, outcomes)
    print_lines(lines)
    failed = [f"{line.check}: {line.found} -> {line.remedy}" for line in lines
              if line.result == "FAIL" and line.check not in LATER]  # fmt: skip
    numbers = {}
    for line in lines:
        percent = re.match(r"([0-9.]+) %", line.found)
        if line.check == "monitor speed" and percent is not None:
            numbers[MONITOR_SPEED] = float(percent[1])
    return Judgement("; ".join(failed), numbers)


def judge_installation(cell_file: Path, outcomes: Sequence[Outcome]) -> Judgement:
    """Fail with the findings of the installation check, or with what it could not observe."""
    report = outcomes[0].report
    if not report:
        return by_exit_code(cell_file, outcomes)
    found = [f"{each['text']} -> {each['remedy']}" for each in report["findings"]]
    if not found and outcomes[0].code != OK:
        found = [f"{report['verdict']}: {'; '.join(report['not_shown'])}"]
    echo(f"{report['source']}\n{report['verdict']}")
    return Judgement("; ".join(found), _rounded(report["evidence"]))


def judge_press(cell_file: Path, outcomes: Sequence[Outcome]) -> Judgement:
    """Keep the numbers of the press."""
    report: dict[str, Any] = next((each.report for each in outcomes if each.report), {})
    numbers = _rounded({name: report[name] for name in OF_A_PRESS if name in report})
    echo(", ".join(f"{name} {value:g}" for name, value in numbers.items()))
    return Judgement(by_exit_code(cell_file, outcomes).why, numbers)


def judge_probe(cell_file: Path, outcomes: Sequence[Outcome]) -> Judgement:
    """Keep what the probe found for the cell file."""
    why = by_exit_code(cell_file, outcomes).why
    if why:
        return Judgement(why)
    probe = read_model(ProbeFile, named_files(cell_file)["probe"])
    found = {
        "delay_s": probe.robot.delay_s,
        "lag_s": probe.robot.lag_s,
        "motions_ahead": probe.robot.motions_ahead,
        "least_segment_s": probe.gateway.least_segment_s,
        MONITOR_SPEED: probe.number("mspeed"),
    }
    return Judgement("", _rounded({name: value for name, value in found.items() if value}))


def judge_calibration(cell_file: Path, outcomes: Sequence[Outcome]) -> Judgement:
    """Keep the mass that was found."""
    why = by_exit_code(cell_file, outcomes).why
    calibration = None if why else load_cell(cell_file).calibration
    if not isinstance(calibration, CalibrationSection):
        return Judgement(why or "it passed, but the cell file's calibration is not there")
    return Judgement("", _rounded({"mass_kg": calibration.payload.mass_kg}))


def judge_tuning(cell_file: Path, outcomes: Sequence[Outcome]) -> Judgement:
    """Keep the values that were written for the cell file."""
    why = by_exit_code(cell_file, outcomes).why
    if why:
        return Judgement(why)
    path = named_files(cell_file)["tuning"]
    found = {name: value for section in read_yaml(path, str(path)).values()
             for name, value in section.items()}  # fmt: skip
    return Judgement("", _rounded(found))


def _rounded(numbers: dict[str, Any]) -> dict[str, float]:
    return {name: float(f"{value:.4g}") for name, value in numbers.items()}
