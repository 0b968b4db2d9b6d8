"""README and architecture: short, and true to the repository."""

import re

from tools.tree import ROOT

README = ROOT / "README.md"
ARCHITECTURE = ROOT / "docs" / "architecture.md"
LONGEST_LINES = 120
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def test_the_front_page_is_short() -> None:
    """At most 120 lines."""
    assert len(README.read_text(encoding="utf-8").splitlines()) <= LONGEST_LINES


def test_each_of_the_three_numbers_is_on_the_page_that_its_row_links() -> None:
    """A page that was measured again changes the front page as well."""
    section = README.read_text(encoding="utf-8").split("## Three numbers")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")][1:]
    assert len(rows) == 3
    for row in rows:
        text, target = row.rsplit("](", 1)
        page = (ROOT / target.partition("#")[0].rstrip(") |")).read_text(encoding="utf-8")
        stated = NUMBER.findall(text.replace("Axia80", ""))
        assert stated
        assert [number for number in stated if number not in NUMBER.findall(page)] == []


def test_every_folder_of_the_map_exists() -> None:
    """The map names the folders that are there."""
    page = ARCHITECTURE.read_text(encoding="utf-8")
    folders = re.findall(r"^\| `([a-z]+)/` \|", page, re.MULTILINE)
    assert len(folders) > 5
    assert all((ROOT / folder).is_dir() for folder in folders)
