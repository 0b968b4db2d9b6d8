"""Conditions of a step: the cell up with its present file, or down; files that it names."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest
import yaml

from cli.bringup import needs
from cli.bringup.needs import (
    RunningCell,
    Situation,
    calibration_named,
    cell_down,
    cell_up,
    probe_named,
    situation_of,
    tuning_named,
)
from common.config.load import cell_hash, load_cell
from forcemesh.errors import BusError
from forcemesh.messages import Health
from launch.run_file import new_run, write_run


class AnsweringCell:
    """A client of a cell whose processes report, or do not."""

    health_of: ClassVar[dict[str, Health | None]] = {}

    def __init__(self, _cell: object, **_options: object) -> None:
        """Connect."""

    def __enter__(self) -> "AnsweringCell":
        """Begin."""
        return self

    def __exit__(self, *_: object) -> None:
        """End."""

    def health(self, role: str) -> Any:
        """Return the feed of a role."""
        reading = SimpleNamespace(message=self.health_of[role])
        return SimpleNamespace(wait=lambda _within_s: reading)


def answer(monkeypatch: pytest.MonkeyPatch, arbiter: Health | None, robot: Health | None) -> None:
    """Let the cell report."""
    monkeypatch.setattr(AnsweringCell, "health_of", {"arbiter": arbiter, "robot": robot})
    monkeypatch.setattr(needs, "ConfiguredCell", AnsweringCell)


def test_a_cell_that_is_up_reports_its_configuration_and_monitor_speed(
    cell_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unknown where no process responds or the robot has no monitor speed."""
    robot = Health(numbers={"monitor_speed_fraction": 0.25})
    answer(monkeypatch, Health(config_hash="abc"), robot)
    assert situation_of(cell_file).running == RunningCell("abc", 25.0)
    answer(monkeypatch, None, Health())
    found = situation_of(cell_file)
    assert found.running == RunningCell("", None)
    assert "`forcemesh status`" in cell_up(found)


def test_a_cell_is_up_when_its_hub_or_its_supervisor_is(
    cell_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise its start is the remedy, and the controller's connection is free."""

    def refuse(*_: object, **_options: object) -> None:
        raise BusError("no hub")

    monkeypatch.setattr(needs, "ConfiguredCell", refuse)
    down = situation_of(cell_file)
    assert down.running is None
    assert f"`forcemesh up --cell {cell_file}`" in cell_up(down)
    assert cell_down(down) == ""
    write_run(new_run(load_cell(cell_file), cell_file))  # this test is the supervisor
    up = situation_of(cell_file)
    assert up.running == RunningCell("", None)
    assert "Ctrl-C" in cell_down(up)


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
    named = {"robot.probe": probe_named, "calibration": calibration_named, "tuning": tuning_named}
    tree = yaml.safe_load(cell_file.read_text())
    for key, need in named.items():
        assert f"as {key}: set `" in need(Situation(cell_file, None))
        section = tree["robot"] if key == "robot.probe" else tree
        section[key.rpartition(".")[2]] = "file.yaml"
    cell_file.write_text(yaml.safe_dump(tree))
    assert [need(Situation(cell_file, None)) for need in named.values()] == ["", "", ""]
