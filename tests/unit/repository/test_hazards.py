"""docs/hazards.md: every hazard has a row, and each named proof exists."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "hazards.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| (H\d\d) \|(.*)\|$", PAGE, re.MULTILINE)


def test_every_hazard_has_one_row_in_order() -> None:
    """H01 to H54, as the analysis numbers them."""
    assert [row for row, _ in ROWS] == [f"H{number:02d}" for number in range(1, 55)]


def test_every_test_that_is_named_exists() -> None:
    """File and function; a test that was renamed would leave a claim without its proof."""
    named = re.findall(r"`([a-z_/]+\.py)::(test_\w+)`", PAGE)
    assert len(named) > 40
    for file, function in named:
        text = (ROOT / "tests" / file).read_text(encoding="utf-8")
        assert f"def {function}(" in text, f"{file}::{function}"


def test_every_command_that_is_named_is_a_target_of_make() -> None:
    """A reader can run each of them."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"`make ([a-z-]+)`", PAGE)):
        assert f"\n{target}:" in makefile, target


def test_no_row_is_left_open() -> None:
    """A row names its proof, or the reason why there is none."""
    for row, text in ROWS:
        assert "PENDING" not in text, row
        assert text.rstrip().rsplit("|", 1)[1].strip(), row
