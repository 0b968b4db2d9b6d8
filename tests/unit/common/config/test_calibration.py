"""The calibration file: read back as written, never mixed up with another, named by a cell file."""

import datetime as dt
from pathlib import Path
from typing import Any

import pytest
import yaml

from common.config.calibration import CalibrationSection, Residuals
from common.config.cell_terms import FrameSection
from common.config.load import CALIBRATION, cell_from_tree, dump_cell, load_cell, named_file
from common.config.payload import Payload
from forcemesh.errors import ConfigError

DEMO = Path(__file__).parents[4] / "cells" / "demo.yaml"
NOTHING_LEFT = Residuals(
    poses=10, force_mean_N=0.01, force_max_N=0.02, torque_mean_Nm=0.0005, torque_max_Nm=0.001
)


def calibration(**changes: Any) -> CalibrationSection:
    """Return one of the demo's tool."""
    fields: dict[str, Any] = {
        "cell": "demo",
        "made_at": dt.datetime(2026, 11, 22, 4, 0, tzinfo=dt.UTC),
        "method": "arm",
        "T_flange_tcp": FrameSection(position_m=(0.0, 0.0, 0.16)),
        "T_flange_sensor": FrameSection(position_m=(0.0, 0.0, 0.02), oat_deg=(30.0, 0.0, 0.0)),
        "fit": NOTHING_LEFT,
        "verified": NOTHING_LEFT,
        "payload": Payload(mass_kg=1.5, com_m=(0.01, 0.02, 0.03)),
    }
    return CalibrationSection(**(fields | changes))


def cell_with(folder: Path, found: CalibrationSection | None) -> Path:
    """Write the demo's cell file, and the calibration that it names."""
    path = folder / "cells" / "demo.yaml"
    path.parent.mkdir()
    text = DEMO.read_text(encoding="utf-8")
    text = text.replace("calibration: none", "calibration: ../calibration/demo.yaml")
    path.write_text(text, encoding="utf-8")
    if found is not None:
        found.save(folder / "calibration" / "demo.yaml")
    return path


@pytest.mark.parametrize(
    ("content", "mistake"),
    [
        ("", "map of sections"),
        ("payload: {mass: 1}", "payload.mass: unknown name; did you mean mass_kg"),
        ("payload: {torque_gain: [1, 1, 2]}", "torque_gain is not corrected any more: calibrate"),
        ("cell: [demo\n", "not YAML"),
        *((chars, "demo.yaml: ") for chars in range(0, 550, 41)),  # the rest of it are defaults
    ],
)
def test_a_calibration_file_that_is_not_whole_is_an_error(
    content: str | int, mistake: str, tmp_path: Path
) -> None:
    """Empty, of another kind, or cut off after a number of characters: the error names the file."""
    path, file = cell_with(tmp_path, calibration()), tmp_path / "calibration" / "demo.yaml"
    whole = file.read_text(encoding="utf-8")
    cut = whole[:content] if isinstance(content, int) else content
    file.write_text(cut, encoding="utf-8")
    with pytest.raises(ConfigError, match=mistake) as error:
        load_cell(path)
    assert error.value.source == str(file)
    assert "move the file away" in str(error.value)


@pytest.mark.parametrize("found", [3, [], "made.yaml"])
def test_another_value_as_calibration_is_an_error(found: object) -> None:
    """A parsed cell file holds the calibration itself, or `none`."""
    tree = yaml.safe_load(dump_cell(load_cell(DEMO))) | {"calibration": found}
    with pytest.raises(ConfigError, match="calibration: must be a path or `none`"):
        cell_from_tree(tree, "cell.yaml")


def test_a_cell_written_out_keeps_its_calibration(tmp_path: Path) -> None:
    """It is found from the cell file's folder, and a copy in another folder keeps it."""
    path = cell_with(tmp_path, calibration())
    cell = load_cell(path)
    assert cell.calibration == calibration()
    assert named_file(path, CALIBRATION) == path.parent / "../calibration/demo.yaml"
    assert load_cell(DEMO, with_files=False).calibration == "none"
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump_cell(cell), encoding="utf-8")
    assert load_cell(copy) == cell
    assert named_file(copy, CALIBRATION) is None


def test_the_revision_distinguishes_calibrations() -> None:
    """Whatever differs, the revision does; the same numbers have the same one."""
    others = (
        {"cell": "other"},
        {"method": "manual"},
        {"sensor": "FT1"},
        {"verified": None},
        {"payload": Payload(mass_kg=1.5, com_m=(0.01, 0.02, 0.0300001))},
    )
    revisions = {calibration(**changes).revision for changes in others}
    assert len(revisions | {calibration().revision}) == len(others) + 1
    assert calibration().revision == calibration().revision


def test_an_edited_file_is_reported(tmp_path: Path) -> None:
    """A number changed by hand is no result of a calibration; deleting the revision admits it."""
    path = cell_with(tmp_path, calibration())
    file = tmp_path / "calibration" / "demo.yaml"
    text = file.read_text(encoding="utf-8").replace("mass_kg: 1.5", "mass_kg: 1.6")
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match="changed after it was written"):
        load_cell(path)
    lines = [line for line in text.splitlines() if not line.startswith("revision")]
    file.write_text("\n".join(lines), encoding="utf-8")
    edited = load_cell(path).calibration
    assert isinstance(edited, CalibrationSection)
    assert edited.payload.mass_kg == 1.6
    assert edited.revision != calibration().revision
