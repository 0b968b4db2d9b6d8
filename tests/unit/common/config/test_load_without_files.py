"""A cell file is read without the files that it names, for a verb that writes one of them."""

from pathlib import Path

import pytest

from common.config.load import CALIBRATION, PROBE, TUNING, load_cell, named_file
from forcemesh.errors import ConfigError
from tests.fakes.bench import DEMO

TEXT = DEMO.with_name("demo-tcp.yaml").read_text(encoding="utf-8")
NAMED = {CALIBRATION: "none/calibration.yaml", PROBE: "probe.yaml", TUNING: "tuning.yaml"}


@pytest.fixture
def cell_file(tmp_path: Path) -> Path:
    """A cell file that names three files, of which the probe is broken and the others missing."""
    text = TEXT.replace("calibration: none", f"calibration: {NAMED[CALIBRATION]}")
    text = text.replace("  model: rs007l\n", f"  model: rs007l\n  probe: {NAMED[PROBE]}\n")
    (tmp_path / NAMED[PROBE]).write_text("no: [probe", encoding="utf-8")
    path = tmp_path / "cell.yaml"
    path.write_text(f"{text}\ntuning: {NAMED[TUNING]}\n", encoding="utf-8")
    return path


def test_missing_and_broken_files_do_not_matter_without_them(cell_file: Path) -> None:
    """With them the file is refused; its own values are read either way."""
    assert {key: named_file(cell_file, key) for key in NAMED} == {
        key: cell_file.parent / name for key, name in NAMED.items()
    }
    with pytest.raises(ConfigError, match=r"probe\.yaml|tuning\.yaml"):
        load_cell(cell_file)
    cell = load_cell(cell_file, with_files=False)
    assert cell.robot.delay_s == load_cell(DEMO.with_name("demo-tcp.yaml")).robot.delay_s


def test_a_section_that_is_none_is_a_mistake_as_with_them(cell_file: Path) -> None:
    """The message names it."""
    cell_file.write_text("cell: demo\nrobot: 3\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="robot"):
        load_cell(cell_file, with_files=False)
