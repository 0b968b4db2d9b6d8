"""README.md and docs: a figure that no command wrote, and no reviewer listed, fails here."""

import random
import re
import shutil
from pathlib import Path

import pytest

from tools import figures

PLANTED = 30


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """README.md and docs, to be spoilt."""
    shutil.copy(figures.ROOT / "README.md", tmp_path)
    (tmp_path / "docs").mkdir()
    for page in (*(figures.ROOT / "docs").glob("*.md"), figures.LIST):
        shutil.copy(page, tmp_path / "docs")
    return tmp_path


def test_every_figure_is_written_by_a_command_or_was_read() -> None:
    """Else: run the command of the block, or `python -m tools.figures --list` and review it."""
    assert list(figures.mismatches()) == []


def test_a_planted_change_of_any_figure_is_found(copy: Path) -> None:
    """In a block or outside of one, whichever digit it is."""
    draw = random.Random(0)
    places = [
        (page, figure.start() + digit.start())
        for page in figures.pages(copy)
        for figure in figures.FIGURE.finditer(page.read_text("utf-8"))
        for digit in re.finditer(r"\d", figure.group())
    ]
    assert list(figures.mismatches(copy)) == []
    for page, place in draw.sample(places, PLANTED):
        text = page.read_text("utf-8")
        digit = str((int(text[place]) + draw.randrange(1, 9)) % 10)
        page.write_text(text[:place] + digit + text[place + 1 :], "utf-8")
        assert list(figures.mismatches(copy)) != [], (page.name, text[place - 20 : place + 20])
        page.write_text(text, "utf-8")


@pytest.mark.parametrize(
    "added", ["It settles in 12 ms.", "5.3 times faster", "to 0.01 N·m", "99 %"]
)
def test_a_new_figure_without_review_is_found(copy: Path, added: str) -> None:
    """Wherever it is written."""
    page = copy / "README.md"
    page.write_text(f"{page.read_text('utf-8')}\n{added}\n", "utf-8")
    assert [text for text in figures.mismatches(copy) if text.startswith("README.md: figure")]


def test_a_block_is_put_in_the_place_of_the_old_one_with_its_stamp(tmp_path: Path) -> None:
    """Name, command, commit and day stand in its mark; the text around it stays."""
    page = tmp_path / "page.md"
    page.write_text(f"before\n{figures.block('speed', 'old', 'make old')}\nafter\n")
    figures.replace_block(page, "speed", "| 7 ms |", 'make bench ARGS="speed --write"')
    text = page.read_text()
    (found,) = figures.BLOCK.finditer(text)
    assert (found["name"], found["text"]) == ("speed", "| 7 ms |")
    assert found["command"] == 'make bench ARGS="speed --write"'
    assert found["sum"] == figures.check_sum("| 7 ms |")
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    with pytest.raises(ValueError, match="no block `pace`"):
        figures.replace_block(page, "pace", "", "make")
