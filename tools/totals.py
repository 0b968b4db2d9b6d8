"""Totals of the project by top folder and by room: `make totals`.

lines, tokens (without docstrings, comments and layout) and module constants of Python; tests: lines
of the unit tests in the mirrored folder; words: of pages. The table is tools/totals.txt. Exit code
1 if a row has grown: the change that lets it grow writes the table, where a reviewer sees it.
"""

import argparse
import ast
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

from tools.tree import FOLDERS, ROOT, WITH_PAGES, Module, modules, pages

TABLE = Path("tools") / "totals.txt"
COLUMNS = ("lines", "tokens", "constants", "tests", "words")
TOP = "README.md and others"
# Rooms are more, or less, than a folder. A file belongs to the first one that lists it.
ROOMS = {
    "control path": (
        "control", "services/wrench", "services/regulator", "services/arbiter", "services/gateway",
        "common/motion", "common/robot", "common/runtime",
    ),
    "other services": ("services",),
    "rest of common, forcemesh, controller, launch": (
        "common", "forcemesh", "controller", "launch",
    ),
    "cli, procedures": ("cli", "procedures"),
    "identification, tuning": ("identification", "tuning"),
    "bench, tools": ("bench", "tools"),
    "fakes of the tests": ("tests/fakes",),
}  # fmt: skip
LAYOUT = frozenset(
    (
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENCODING,
        tokenize.ENDMARKER,
    )
)
OWNERS = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
Numbers = tuple[int, ...]
NOTHING: Numbers = (0,) * len(COLUMNS)


def tokens(module: Module) -> int:
    """Return the number of tokens without docstrings, comments and layout."""
    docstrings = {
        node.body[0].lineno
        for node in ast.walk(module.tree)
        if isinstance(node, OWNERS) and ast.get_docstring(node, clean=False) is not None
    }
    with module.path.open("rb") as file:
        return sum(
            token.type not in LAYOUT
            and not (token.type == tokenize.STRING and token.start[0] in docstrings)
            for token in tokenize.tokenize(file.readline)
        )


def constants(module: Module) -> int:
    """Return the number of names in capitals that a module defines at its top level."""
    targets = (
        target
        for node in module.tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    )
    return sum(isinstance(target, ast.Name) and target.id.isupper() for target in targets)


def counts(root: Path) -> Iterator[tuple[str, Numbers]]:
    """Yield what each file adds, by its path; a unit test also by the path that it mirrors."""
    for module in modules(root, (*FOLDERS, "examples")).values():
        path = module.path.relative_to(root).as_posix()
        yield path, (module.lines, tokens(module), constants(module), 0, 0)
        mirrored = path.removeprefix("tests/unit/")
        if mirrored != path and mirrored.startswith(FOLDERS):
            yield mirrored, (0, 0, 0, module.lines, 0)
    for page in pages(root):
        words = len(page.read_text(encoding="utf-8").split())
        yield page.relative_to(root).as_posix(), (0, 0, 0, 0, words)


def totals(root: Path) -> dict[str, Numbers]:
    """Return the numbers of each row."""
    found = dict.fromkeys((*WITH_PAGES, TOP, *ROOMS, "production", "all"), NOTHING)
    for path, numbers in counts(root):
        top = path.partition("/")[0]
        names = ["all", top if "/" in path else TOP]
        names += ["production"] if top in FOLDERS and top != "tests" else []
        names += [room for room, places in ROOMS.items() if is_in(path, places)][:1]
        for name in names:
            found[name] = tuple(map(sum, zip(found[name], numbers, strict=True)))
    return found


def is_in(path: str, places: tuple[str, ...]) -> bool:
    """Return whether a file is in one of the folders."""
    return path.startswith(tuple(f"{place}/" for place in places))


def written(found: dict[str, Numbers]) -> str:
    """Return the table."""
    head = "Kept by `make totals ARGS=--write`; what is counted: tools/totals.py\n\n"
    rows = [("", COLUMNS), *found.items()]
    return head + "".join(
        f"{name:48}{''.join(f'{each:>10}' for each in row)}\n" for name, row in rows
    )


def read(table: str) -> dict[str, Numbers]:
    """Return the numbers of a written table."""
    rows = table.splitlines()[3:]
    return {row[:48].strip(): tuple(map(int, row[48:].split())) for row in rows}


def raised(found: dict[str, Numbers], table: dict[str, Numbers]) -> Iterator[str]:
    """Yield each number that is above that of the table, or has none there."""
    for name, numbers in found.items():
        for column, now, before in zip(COLUMNS, numbers, table.get(name, NOTHING), strict=True):
            if now > before:
                yield f"{name}: {now} {column}, the table has {before}"


def main(words: list[str], root: Path = ROOT) -> int:
    """Compare or write the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="make totals ARGS=...", description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write {TABLE}")
    found = totals(root)
    if parser.parse_args(words).write:
        (root / TABLE).write_text(written(found), encoding="utf-8")
    grown = list(raised(found, read((root / TABLE).read_text(encoding="utf-8"))))
    for each in grown or [f"{TABLE}: no row has grown"]:
        print(each)
    return 1 if grown else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
