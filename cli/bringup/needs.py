"""Conditions of the steps of a bring-up: the cell up or down, files named in the cell file."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cli.context import CONNECT_PATIENCE_S
from common.bus.configured_cell import ConfiguredCell
from common.config.load import CALIBRATION, PROBE, TUNING, cell_hash, load_cell, named_file
from forcemesh.errors import BusError
from launch.run_file import read_run

HEALTH_WITHIN_S = 5.0  # the robot process reports once a second


@dataclass(frozen=True, slots=True)
class RunningCell:
    """What a cell that is up reports: its configuration, and the monitor speed if known."""

    config_hash: str
    monitor_speed_percent: float | None


@dataclass(frozen=True, slots=True)
class Situation:
    """The cell file, and the cell as it was found before a step; None: it is not up."""

    cell_file: Path
    running: RunningCell | None


Need = Callable[[Situation], str]  # what is missing with its remedy, empty if nothing


def situation_of(cell_file: Path) -> Situation:
    """Ask a cell that is up for its configuration and monitor speed. Raises ConfigError."""
    cell = load_cell(cell_file, with_files=False)
    try:
        with ConfiguredCell(cell, patience_s=CONNECT_PATIENCE_S) as client:
            arbiter = client.health("arbiter").wait(HEALTH_WITHIN_S).message
            robot = client.health("robot").wait(HEALTH_WITHIN_S).message
    except BusError:
        run = read_run(cell.cell)
        is_up = run is not None and run.live
        return Situation(cell_file, RunningCell("", None) if is_up else None)
    fraction = getattr(robot, "numbers", {}).get("monitor_speed_fraction")
    return Situation(
        cell_file,
        RunningCell(
            getattr(arbiter, "config_hash", ""), None if fraction is None else 100.0 * fraction
        ),
    )


def cell_up(found: Situation) -> str:
    """Require a cell that is up, with the cell file as it is now."""
    up = f"`forcemesh up --cell {found.cell_file}` in another terminal"
    if found.running is None:
        return f"the cell is not up: {up}"
    if not found.running.config_hash:
        return "the cell is up, but its processes do not respond: `forcemesh status`"
    if found.running.config_hash != cell_hash(load_cell(found.cell_file, {"calibration": None})):
        return f"the cell file has changed since the cell was started: Ctrl-C there, then {up}"
    return ""


def cell_down(found: Situation) -> str:
    """Require that no gateway uses the controller's only connection."""
    if found.running is None:
        return ""
    return "the cell is up and uses the controller's connection: Ctrl-C in its terminal"


def probe_named(found: Situation) -> str:
    """Require that the cell file takes the values of the probe."""
    return _named(found, PROBE, "set `probe: probe.yaml` in the section robot")


def calibration_named(found: Situation) -> str:
    """Require that the cell file names its calibration."""
    name = f"../calibration/{found.cell_file.stem}.yaml"
    return _named(found, CALIBRATION, f"set `calibration: {name}`")


def tuning_named(found: Situation) -> str:
    """Require that the cell file takes the values of the tuning."""
    return _named(found, TUNING, "set `tuning: tuning.yaml`")


def _named(found: Situation, key: str, remedy: str) -> str:
    if named_file(found.cell_file, key) is not None:
        return ""
    return f"{found.cell_file} does not name a file as {key}: {remedy}"
