"""docs/as-emulator.md lists the names of the code, no more and no less."""

import re
from pathlib import Path

import pytest

from sim.as_language import keywords
from sim.as_language.special_functions import ALL_NAMES

PAGE = (Path(__file__).resolve().parents[4] / "docs" / "as-emulator.md").read_text("utf-8")


def listed(title: str) -> set[str]:
    """The names in the block behind `<!-- title -->`."""
    block = re.search(rf"<!-- {title} -->\n```\n(.*?)```", PAGE, re.DOTALL)
    assert block is not None
    names = re.findall(r"MC [A-Z]+|[$#]?[A-Z][A-Z0-9_]*", block[1])
    assert len(names) == len(set(names))
    return set(names)


@pytest.mark.parametrize(
    ("title", "known"),
    [
        ("instructions", set(keywords.EMULATED)),
        ("functions", set(ALL_NAMES)),
        ("parsed only", keywords.KNOWN - keywords.EMULATED),
    ],
)
def test_the_page_lists_every_name_once(title: str, known: set[str]) -> None:
    """Executed, computed and merely parsed names."""
    assert listed(title) == known
