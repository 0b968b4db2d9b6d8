"""Unit tests mirror the tree: tests/unit/<folder>/test_<module>[_<aspect>].py."""

from pathlib import Path

import pytest

from tools.tree import ROOT

UNIT = ROOT / "tests" / "unit"
NO_MODULE = "repository"  # pages, containers and tables of the repository as a whole


def module_names(folder: Path) -> set[str]:
    """Return the names that a test file of a folder may begin with."""
    names = {path.stem if path.suffix == ".py" else path.name for path in folder.iterdir()}
    return {name.strip("_").replace(".", "_") for name in names}


def is_in_place(path: Path) -> bool:
    """Return whether a test file names a module of the folder that it mirrors."""
    folder = ROOT / path.parent.relative_to(UNIT)
    parts = path.stem.removeprefix("test_").split("_")
    if path.parent == UNIT / NO_MODULE:
        return True
    names = module_names(folder) if folder.is_dir() else set()
    return any("_".join(parts[:count]) in names for count in range(1, len(parts) + 1))


@pytest.mark.parametrize("path", sorted(UNIT.rglob("test_*.py")), ids=lambda path: path.stem)
def test_a_unit_test_stands_where_its_module_stands(path: Path) -> None:
    """A reader of a module finds its tests without a search."""
    assert is_in_place(path), (
        f"{path.relative_to(ROOT)}: no module of that name in {path.parent.relative_to(UNIT)}; "
        "name it tests/unit/<folder>/test_<module>[_<aspect>].py"
    )


@pytest.mark.parametrize(
    "name", ["services/arbiter/test_nothing.py", "nowhere/test_core.py", "test_core.py"]
)
def test_a_test_of_no_module_is_found(name: str) -> None:
    """The rule can be broken."""
    assert not is_in_place(UNIT / name)
