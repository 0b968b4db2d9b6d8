"""READMEs of folders name files that exist, and pages the schema version of the code."""

import re
from pathlib import Path

import pytest

from forcemesh.codec import SCHEMA_VERSION
from tools.tree import FOLDERS, ROOT

FILE_NAME = re.compile(r"`([\w./-]+\.(?:py|sh|html))`")


def folder_readmes() -> list[Path]:
    """Return every README below the root that the repository has."""
    found = [path for folder in FOLDERS for path in (ROOT / folder).rglob("README.md")]
    assert len(found) > 10
    return sorted(found)


@pytest.mark.parametrize("path", folder_readmes(), ids=lambda path: path.parent.name)
def test_a_file_that_a_readme_names_exists(path: Path) -> None:
    """Relative to the folder or to the root; found stale after files were renamed."""
    for name in FILE_NAME.findall(path.read_text(encoding="utf-8")):
        here = (path.parent / name).exists() or (ROOT / name).exists()
        assert here, f"{path.relative_to(ROOT)} names {name}, which does not exist"


@pytest.mark.parametrize(
    "main", sorted((ROOT / "services").glob("*/__main__.py")), ids=lambda main: main.parent.name
)
def test_the_readme_of_a_service_lists_its_files(main: Path) -> None:
    """As README.md says; `__init__` is empty, and `__main__` is the same in each."""
    home = main.parent
    text = (home / "README.md").read_text(encoding="utf-8")
    names = {path.stem for path in home.glob("*.py")} - {"__init__", "__main__"}
    assert [name for name in sorted(names) if not re.search(rf"`{name}(\.py)?`", text)] == []


def test_the_page_of_the_bus_has_the_schema_version_of_the_code() -> None:
    """A reader in another language compares with it."""
    page = (ROOT / "docs" / "bus.md").read_text(encoding="utf-8")
    assert f"| schema version, {SCHEMA_VERSION};" in page
