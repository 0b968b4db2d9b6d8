"""The list of modules of which every branch is tested, and the few lines that are left out."""

import re
import tomllib
from pathlib import Path

from tools.tree import production_files

ROOT = Path(__file__).resolve().parents[3]
CONFIG = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["coverage"]
MOST_LEFT_OUT = 1


def test_the_list_names_modules_that_are_there() -> None:
    """A module that was renamed would leave the list without a word; every branch counts."""
    for pattern in CONFIG["run"]["include"]:
        assert list(ROOT.glob(pattern)), pattern
    assert CONFIG["run"]["branch"]
    assert CONFIG["report"]["fail_under"] == 100


def test_a_line_that_is_left_out_has_its_reason() -> None:
    """And there are hardly any."""
    found = [
        line
        for path in production_files()
        for line in path.read_text(encoding="utf-8").splitlines()
        if "no cover" in line
    ]
    assert len(found) <= MOST_LEFT_OUT
    assert all(re.search(r"# pragma: no cover - \w+( \w+){3,}", line) for line in found)
