"""Verb `doctor`: checks of everything between this PC and the arm, with remedies."""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

from typer import Exit, Option, echo

from cli.context import (
    NO_ANSWER,
    NOT_WELL,
    OK,
    USAGE,
    CellOption,
    JsonOption,
    find_cell_file,
    one_line_errors,
    waiting,
)
from forcemesh.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from cli.doctor.checks import ReportLine
    from common.config.cell import CellConfig

LATENCY_HELP = "Also measure for so long how late each core wakes a process, as cyclictest [s]."
Latency = Annotated[
    float, Option("--latency", min=0.0, max=86_400.0, metavar="SECONDS", help=LATENCY_HELP)
]
COLOURS = {"PASS": "green", "WARN": "yellow", "FAIL": "red", "SKIP": "dim"}
# A FAIL of one of these means that no peer was reached.
CONNECTION_CHECKS = ("address", "hello", "bus")


def doctor(latency_s: Latency = 0.0, as_json: JsonOption = False, cell: CellOption = None) -> None:
    """Check this PC, sensor and controller, with remedies; the arm does not move.

    It checks versions, clock, priority, ports and calibration and requests the sensor's stream.
    It connects to the controller, sends command 12 followed by a hold, and leaves it held.
    While the cell is up it reads the bus instead: sensor and controller accept one client only.
    """
    with one_line_errors():
        from cli.doctor.checks import finding, passed
        from common.config.evidence import measured_monitor_speed
        from common.config.load import cell_hash, load_cell

        path, name = find_cell_file(cell), None
        try:
            loaded = load_cell(path)
        except ConfigError as error:
            lines = [finding("cell file", "FAIL", str(error), "cell file")]
        else:
            from cli.doctor.report import check_cell

            name, lines = loaded.cell, [passed("cell file", f"{path}, {cell_hash(loaded)}")]
            lines += _probe_lines(path, loaded)
            if not as_json:
                echo(f"cell {name} ({path}): checking, a few seconds")
            with waiting("this PC, the sensor, the robot or the bus"):
                lines += check_cell(loaded, measured_monitor_speed(path))
            if latency_s > 0.0:
                from cli.doctor.latency import latency_lines

                if not as_json:
                    echo(f"each core: {latency_s:g} s")
                lines += latency_lines(loaded, latency_s)
    code = exit_code(lines)
    if as_json:
        report = {
            "cell": name,
            "cell_file": str(path),
            "lines": [asdict(row) for row in lines],
            "exit_code": code,
        }
        print(json.dumps(report))
    else:
        print_lines(lines)
    raise Exit(code)


def _probe_lines(path: "Path", cell: "CellConfig") -> "list[ReportLine]":
    """Return the rows of the probe that the cell file names, none without one."""
    from datetime import UTC, datetime

    from cli.doctor.probe import probe_lines
    from common.config.load import PROBE, named_file
    from common.config.probe import ProbeFile
    from forcemesh.yaml_file import read_model

    file = named_file(path, PROBE)
    if file is None:
        return []
    return probe_lines(cell, read_model(ProbeFile, file), now=datetime.now(UTC))


def exit_code(lines: "list[ReportLine]") -> int:
    """Return the exit code of a report."""
    failed = [line.check for line in lines if line.result == "FAIL"]
    if "cell file" in failed:
        return USAGE
    if any(check in CONNECTION_CHECKS for check in failed):
        return NO_ANSWER
    return NOT_WELL if failed else OK


def print_lines(lines: "list[ReportLine]") -> None:
    """Print a report on the terminal."""
    from rich.console import Console
    from rich.markup import escape

    console = Console(highlight=False, soft_wrap=True)
    width = max(len(line.check) for line in lines)
    for line in lines:
        result = f"[{COLOURS[line.result]}]{line.result}[/]"
        console.print(f"{result}  {line.check:{width}}  {escape(line.found)}")
        if line.remedy:
            console.print(f"      {'':{width}}  -> {escape(line.remedy)}")
    counts = {result: sum(line.result == result for line in lines) for result in COLOURS}
    console.print(
        f"{counts['PASS']} passed, {counts['WARN']} warnings, {counts['FAIL']} failed, "
        f"{counts['SKIP']} skipped"
    )
