"""Keys of older cell files are still read, with one warning."""

from pathlib import Path

import pytest
import yaml

from common.config.load import RENAMED, dump_cell, load_cell
from forcemesh.errors import ConfigError
from tests.fakes.bench import DEMO

VALUES = {"force.given_J": 0.0625, "gateway.max_untaken_setpoints": 2}  # not the defaults


def old_file(folder: Path, old: str, new: str, value: float, *, both: bool = False) -> Path:
    """Write the demo's cell file with an old key."""
    tree, path = yaml.safe_load(DEMO.read_text(encoding="utf-8")), folder / "cell.yaml"
    for dotted in (old, new) if both else (old,):
        section, key = dotted.split(".")
        tree.setdefault(section, {})[key] = value
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_an_old_key_gives_the_new_value_and_one_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str
) -> None:
    """A cell file of an older version starts; a newly written one has the new key."""
    path = old_file(tmp_path, old, new, VALUES[old])
    cells = [load_cell(path), load_cell(path)]
    section, key = new.split(".")
    assert [getattr(getattr(cell, section), key) for cell in cells] == [VALUES[old]] * 2
    assert capsys.readouterr().err == f"{path}: {old} is now {new}: rename it\n"
    assert old.split(".")[1] not in dump_cell(cells[0])


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_old_and_new_key_together_are_a_mistake(tmp_path: Path, old: str, new: str) -> None:
    """Neither value is guessed to be the right one."""
    path = old_file(tmp_path, old, new, VALUES[old], both=True)
    with pytest.raises(ConfigError, match=f"{old}: the old name of {new}, which is set as well"):
        load_cell(path)
