"""Report of the largest Python files and functions; fails above the limits of the house style.

Files: 450 lines (a file is one subject, never split for a number). Functions: 60 lines from
`def` to the last one.
"""

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tools.tree import FOLDERS, ROOT

FILE_LIMIT = 450
TEST_FILE_LIMIT = 450
FUNCTION_LIMIT = 60
SHOWN = 5


@dataclass(frozen=True, slots=True, order=True)
class Size:
    """Number of lines, and location."""

    lines: int
    where: str


def files(root: Path) -> list[Path]:
    """Return every Python file of the project under `root`, sorted."""
    return sorted(path for folder in FOLDERS for path in (root / folder).rglob("*.py"))


def file_size(path: Path, root: Path) -> Size:
    """Return the number of lines of a file."""
    return Size(len(path.read_text(encoding="utf-8").splitlines()), str(path.relative_to(root)))


def function_sizes(path: Path, root: Path) -> Iterator[Size]:
    """Yield the length of each function and method in a file, nested ones too."""
    tree = ast.parse(path.read_text(encoding="utf-8"), filename=str(path))
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            yield Size(lines, f"{path.relative_to(root)}:{node.lineno} {node.name}")


def report(title: str, sizes: list[Size], limit: int) -> bool:
    """Print the largest of `sizes` and all above `limit`; return whether none is."""
    ordered = sorted(sizes, reverse=True)
    too_large = [size for size in ordered if size.lines > limit]
    print(f"{title} (limit {limit} lines)")
    for size in ordered[: max(SHOWN, len(too_large))]:
        print(f"  {size.lines:4d}  {size.where}{'   TOO LONG' if size.lines > limit else ''}")
    return not too_large


def main(root: Path = ROOT) -> int:
    """Report on the project at `root` and return the exit code."""
    paths = files(root)
    functions = [size for path in paths for size in function_sizes(path, root)]
    sizes = [file_size(path, root) for path in paths]
    tests = [size for size in sizes if size.where.startswith("tests")]
    code = [size for size in sizes if size not in tests]
    fits = [
        report("largest files", code, FILE_LIMIT),
        report("largest files of tests", tests, TEST_FILE_LIMIT),
        report("largest functions", functions, FUNCTION_LIMIT),
    ]
    return 0 if all(fits) else 1


if __name__ == "__main__":
    sys.exit(main())
