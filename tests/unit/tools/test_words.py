"""The lint of words finds its listed words, and none in production code."""

import pytest

from tools.tree import FOLDERS
from tools.words import ALLOWED, findings, main, read


def test_the_project_is_clean(capsys: pytest.CaptureFixture[str]) -> None:
    """No listed word; in production code no class and no constant twice."""
    assert main() == 0, capsys.readouterr().out


def test_an_allowed_text_is_still_there() -> None:
    """An exception whose sentence has gone is taken out of the list."""
    sources = read(FOLDERS)
    for path, word in ALLOWED:
        assert word in sources[path].lower(), path


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ('"""What nobody may say."""\n', "a/x.py:1: 'nobody' in a text"),
        ("x = 1  # as it was told\n", "a/x.py:1: 'told' in a text"),
        ('def f(x):\n    return f"{x} has not been heard"\n', "a/x.py:2: 'heard' in a text"),
        ("def mend_it(): ...\n", "a/x.py:1: 'mend' in the name mend_it"),
        ("def _run():\n    was_told = 1\n", "a/x.py:2: 'told' in the name was_told"),
        ("def f(x, *, wanted_N): ...\n", "a/x.py:1: 'wanted' in the name wanted_N"),
        ("x.y_seen = 1\n", "a/x.py:1: 'seen' in the name y_seen"),
        ("import math as told\n", "a/x.py:1: 'told' in the name told"),
        ("class LastWish: ...\n", "a/x.py:1: 'wish' in the name LastWish"),
        ("class Twice: ...\n", "b/y.py:1: class Twice is also in a/x.py"),
        ("SHARE = 0.5\n", "b/y.py:2: SHARE has another value in a/x.py"),
    ],
)
def test_a_planted_word_or_double_is_found(source: str, found: str) -> None:
    """Each rule by one example, with its place."""
    other = "class Twice: ...\nSHARE = 2 * 0.3\n"
    lines = [str(each) for each in findings({"a/x.py": source, "b/y.py": other})]
    assert any(each.startswith(found) for each in lines), lines


@pytest.mark.parametrize(
    "source",
    [
        'return_value = f"{heard:.1f} N received"\n',
        'TEXT = "the way the arm is seen to turn"\n',
        "_SHARE = 0.5\nclass _Twice: ...\n",
        "SHARE = 2 * 0.3\n",
        "SHARE = {0.5: 1}\n",
        '"""Untold, wishful and unheard-of stay."""\n',
    ],
)
def test_right_words_are_left_alone(source: str) -> None:
    """Names inside expressions, private ones, equal values, tables, and parts of longer words."""
    assert findings({"a/x.py": source, "b/y.py": "class Twice: ...\nSHARE = 2 * 0.3\n"}) == []
