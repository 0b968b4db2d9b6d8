"""Totals: what is counted in which row, and that a row grows only with its table."""

from pathlib import Path

import pytest

from tools.totals import COLUMNS, TABLE, main, totals

SOURCE = '''"""Subject."""

LIMIT_N: float = 2.0


def f() -> str:
    # why
    return "x"
'''
TOKENS = 14


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Return a tree with a module in a room, its unit test and a page."""
    files = {
        "services/wrench/core.py": SOURCE,
        "controller/packet.py": "X = 1\n",
        "tests/unit/services/wrench/test_core.py": "def test_f(): ...\n",
        "services/wrench/README.md": "# Three words\n",
        "tools/__init__.py": "",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


def test_what_a_row_counts(root: Path) -> None:
    """No docstring, comment or layout is a token; tests count in the room that they mirror."""
    found = totals(root)
    counted = dict(zip(COLUMNS, found["control path"], strict=True))
    assert counted == {"lines": 8, "tokens": TOKENS, "constants": 1, "tests": 1, "words": 3}
    assert found["services"] == found["control path"]
    assert found["other services"] == (0,) * len(COLUMNS)
    assert found["rest of common, forcemesh, controller, launch"][0] == 1
    assert (found["production"][0], found["tests"][0], found["all"][0]) == (9, 1, 10)


def test_a_row_that_has_grown_is_an_error_until_the_table_is_written(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that has shrunk is none."""
    assert main(["--write"], root) == main([], root) == 0
    page = root / "services" / "wrench" / "README.md"
    page.write_text("# Now it has five\n", encoding="utf-8")
    assert main([], root) == 1
    assert "control path: 5 words, the table has 3" in capsys.readouterr().out
    assert main(["--write"], root) == 0
    page.write_text("", encoding="utf-8")
    assert main([], root) == 0
    assert "control path" in (root / TABLE).read_text(encoding="utf-8")
