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


def test_each_test_that_coverage_leaves_out_is_there() -> None:
    """A test that was renamed would run under coverage, for minutes."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    left_out = re.search(r"^NO_NEW_BRANCH := (.*)$", makefile, re.MULTILINE)
    assert left_out is not None
    tests = "".join(path.read_text("utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    names = set(re.findall(r"def (test_\w+)", tests))
    for part in left_out[1].split(" or "):
        assert any(part.strip() in name for name in names), part


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
