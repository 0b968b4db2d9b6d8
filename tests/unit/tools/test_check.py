"""Rules of `make check` that are our own: each is found where it is broken, and not elsewhere."""

from pathlib import Path

import pytest

from tools.check import main

USED_TWICE = {"cli/a.py": "import common.m\n", "cli/b.py": "import common.m\n"}
DEFINED = "class Twice: ...\nSHARE = 2 * 0.3\n"


def of_lines(file_lines: int, function_lines: int) -> str:
    """Return a module with a function, of so many lines."""
    function = ["def f():", *["    x = 1"] * (function_lines - 1)]
    return "\n".join(function + ["y = 1"] * (file_lines - function_lines)) + "\n"


def plant(root: Path, files: dict[str, str]) -> int:
    """Write files and return the verdict on the tree."""
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return main(root)


@pytest.mark.parametrize(
    ("files", "found"),
    [
        ({"tests/m.py": of_lines(451, 60)}, "tests/m.py: 451 lines, the limit is 450"),
        ({"common/m.py": of_lines(450, 61)}, "common/m.py:1: f has 61 lines, the limit is 60"),
        (
            {"cli/y.py": "class Twice: ...\n"},
            "common/x.py:1: Twice is a class, in cli/y.py a class",
        ),
        ({"cli/y.py": "SHARE = 0.5\n"}, "common/x.py:2: SHARE is 2 * 0.3, in cli/y.py 0.5"),
        ({"cli/y.py": "SHARE: float = 1\n"}, "common/x.py:2: SHARE is 2 * 0.3, in cli/y.py 1"),
        (
            {"common/m.py": "X = 1\n", "cli/a.py": "from common.m import X\n" * 80},
            "common/m.py: 1 lines that only cli.a imports",
        ),
        ({"docs/a.md": "[b](../b.md)"}, "docs/a.md: no file ../b.md"),
        ({"README.md": "# A b\n[b](#b)"}, "README.md: no heading #b"),
    ],
)
def test_a_broken_rule_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], files: dict[str, str], found: str
) -> None:
    """With its place."""
    assert plant(tmp_path, {"common/x.py": DEFINED, **files}) == 1
    assert capsys.readouterr().out == f"{found}\n"


def test_an_import_under_type_checking_closes_a_cycle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Over three modules, each long enough to be no crumb."""
    late = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from common.a import X\n"
    files = {"a": "from common.b import X\n", "b": "from common.c import X\n", "c": late}
    assert plant(tmp_path, {f"common/{n}.py": text + "X = 1\n" * 80 for n, text in files.items()})
    cycle = capsys.readouterr().out.removeprefix("import cycle: ").strip().split(" -> ")
    assert set(cycle) == {"common.a", "common.b", "common.c"}


@pytest.mark.parametrize(
    "files",
    [
        {"tests/m.py": of_lines(450, 60)},
        {"tests/y.py": DEFINED.replace("0.3", "0.5")},  # no production code
        {"cli/y.py": "_SHARE = 0.5\nclass _Twice: ...\n"},
        {"cli/y.py": "SHARE = 2 * 0.3\n"},
        {"cli/y.py": "SHARE = {0.5: 1}\n"},
        {"common/m.py": "X = 1\n", **USED_TWICE},
        {"common/m.py": "X = 1\n" * 80, "cli/a.py": "import common.m\n"},
        {"common/__init__.py": "", "cli/a.py": "import common\n"},
        {
            "docs/a.md": "# A `b`, c\n[b](#a-b-c) `x[0](y)` [site](https://a.b/c)\n```\n[z](z)\n```\n"
        },
    ],
)
def test_what_keeps_the_rules_is_not_named(tmp_path: Path, files: dict[str, str]) -> None:
    """At the limits, private, of equal value, with two importers, in code."""
    assert plant(tmp_path, {"common/x.py": DEFINED, **files}) == 0
