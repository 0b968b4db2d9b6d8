"""The result of `forcemesh check axes`: the cell uses it, and its calibration file keeps it."""

from pathlib import Path

import pytest

from cli.check_axes.verb import report_axes
from common.bus.configured_cell import ConfiguredCell
from common.config.calibration import CalibrationSection
from common.config.load import load_cell
from forcemesh.errors import RefusedError
from identification.installation.terms import Installation, InstallationFinding
from launch.virtual_cell import VirtualCell
from tests.fakes.bench import CELL
from tests.unit.common.config.test_calibration import calibration, cell_with

RIGHT = Installation((), (), {})
WRONG = Installation((InstallationFinding("axes", "x is y", "remap"),), (), {})


def cell_file(folder: Path) -> Path:
    """Write a cell with a calibration, whose axes are not given."""
    path = cell_with(folder, calibration(payload=CELL.payload))
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("axes_given: true", "axes_given: false"), encoding="utf-8")
    return path


def running(path: Path) -> tuple[VirtualCell, ConfiguredCell]:
    """Start a cell from its file."""
    world = VirtualCell(load_cell(path))
    world.advance(1.5)
    return world, ConfiguredCell(world.cell, bus=world.client)


@pytest.mark.parametrize("found", [RIGHT, WRONG])
def test_a_cell_is_armed_for_force_once_its_axes_are_found_right(
    tmp_path: Path, found: Installation
) -> None:
    """At once, and after its next start; before, and when they are wrong, for jog alone."""
    path = cell_file(tmp_path)
    _, cell = running(path)
    with pytest.raises(RefusedError, match="not checked") as refused:
        cell.arm()
    assert refused.value.code == "axes_unproved"
    cell.arm("jog")
    cell.hold("enough")
    report_axes(path, cell, found, "push")
    kept = load_cell(path).calibration
    assert isinstance(kept, CalibrationSection)
    assert kept.revision == calibration(payload=CELL.payload).revision
    assert (kept.axes is not None) == (found is RIGHT)
    _, restarted = running(path)
    if found is RIGHT:
        restarted.arm()
    else:
        with pytest.raises(RefusedError):
            restarted.arm()


def test_a_result_that_no_file_can_keep_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The cell uses the payload of its file: the check counts until the next start."""
    path = tmp_path / "demo.yaml"
    source = Path(__file__).parents[4] / "cells" / "demo.yaml"
    text = source.read_text(encoding="utf-8").replace("axes_given: true", "axes_given: false")
    path.write_text(text, encoding="utf-8")
    world, cell = running(path)
    report_axes(path, cell, RIGHT, "arm")
    assert "until the next start" in capsys.readouterr().err
    world.advance(0.5)
    cell.arm()
