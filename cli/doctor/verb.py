"""Verb `doctor`: checks of everything between this PC and the arm, with remedies."""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

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

if TYPE_CHECKING:
    from pathlib import Path

    from cli.doctor.bus import ObservedCell
    from cli.doctor.checks import ReportLine
    from common.config.cell import CellConfig

COLOURS = {"PASS": "green", "WARN": "yellow", "FAIL": "red", "SKIP": "dim"}
# A FAIL of one of these means that no peer was reached.
CONNECTION_CHECKS = ("address", "hello", "bus")


def doctor(as_json: JsonOption = False, cell: CellOption = None) -> None:
    """Check this PC, sensor and controller, with remedies; the arm does not move.

    It checks versions, clock, priority, ports and calibration and requests the sensor's stream.
    It connects to the controller, sends command 12 followed by a hold, and leaves it held.
    While the cell is up it reads the bus instead: sensor and controller accept one client only.
    """
    with one_line_errors():
        path = find_cell_file(cell)
        lines, loaded = _cell_line(path)
        if loaded is not None:
            if not as_json:
                typer.echo(f"cell {loaded.cell} ({path}): checking, a few seconds")
            with waiting("this PC, the sensor, the robot or the bus"):
                lines += _check_cell(loaded)
    code = exit_code(lines)
    if as_json:
        print(json.dumps(_as_object(loaded, path, lines, code)))
    else:
        print_lines(lines)
    raise typer.Exit(code)


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


def _cell_line(path: "Path") -> "tuple[list[ReportLine], CellConfig | None]":
    from cli.doctor.checks import finding, passed
    from common.config.load import cell_hash, load_cell
    from forcemesh.errors import ConfigError

    try:
        loaded = load_cell(path)
    except ConfigError as error:
        return [finding("cell file", "FAIL", str(error), "cell file")], None
    return [passed("cell file", f"{path}, {cell_hash(loaded)}")], loaded


def _check_cell(cell: "CellConfig") -> "list[ReportLine]":
    """Check this PC and the sensor; then the bus when the cell is up, else the link."""
    from cli.doctor.bus import observe_cell
    from cli.doctor.machine import machine_lines
    from cli.doctor.sensor import sensor_line
    from launch.run_file import read_run

    run, found = read_run(cell.cell), observe_cell(cell)
    is_up = (run is not None and run.live) or found is not None
    lines = [*machine_lines(cell, is_up=is_up), _zenoh(cell, found), sensor_line(cell, is_up=is_up)]
    return [*lines, *_check_robot(cell, found, has_run=run is not None and run.live)]


def _zenoh(cell: "CellConfig", found: "ObservedCell | None") -> "ReportLine":
    """Check whether the bus responds; a cell that is not up has none."""
    from cli.doctor.checks import passed, skipped
    from forcemesh.zenoh_settings import endpoint_of

    endpoint = endpoint_of(cell)
    if found is None:
        return skipped("zenoh", f"no hub responds at {endpoint}: `forcemesh up` starts it")
    return passed("zenoh", f"the hub responds at {endpoint}")


def _check_robot(
    cell: "CellConfig", found: "ObservedCell | None", *, has_run: bool
) -> "list[ReportLine]":
    """Check the bus when the cell is up, else the link; the lines report which and why."""
    from cli.doctor.checks import finding, skipped
    from cli.doctor.report import bus_lines, link_lines, unused_lines
    from controller.packet_table import Scales

    section = cell.gateway if cell.roles.robot == "gateway" else None
    scales = section or Scales()
    if found is not None and (has_run or found.robot is not None or section is None):
        return bus_lines(cell, scales, found)
    if has_run:
        return [finding("bus", "FAIL", "the cell is up, but its hub does not respond", "bus")]
    if section is None:
        no_hub = finding("bus", "FAIL", "no hub responds: the cell is not up", "bus.down")
        return [no_hub, *unused_lines(cell)]
    from cli.doctor.link import visit_controller

    lines = link_lines(
        cell, section, scales, visit_controller(section.host, section.port, scales, arm=section.arm)
    )
    return [*lines, skipped("processes", "the cell is not up: the link itself was checked")]


def _as_object(
    cell: "CellConfig | None", path: "Path", lines: "list[ReportLine]", code: int
) -> dict[str, Any]:
    return {
        "cell": None if cell is None else cell.cell,
        "cell_file": str(path),
        "lines": [asdict(row) for row in lines],
        "exit_code": code,
    }
