"""Rules of source and pages that no linter checks: `python -m tools.check`.

- A file has at most 450 lines (it is one subject, never split for a number), a function 60.
- In production code no two public classes have one name, and no two constants of one name have two
  numbers as values.
- No modules of production code import each other, directly or over others, also under
  TYPE_CHECKING. No crumb: a module below 80 lines that exactly one other imports belongs to it.
- A relative link of a page leads to a file, and to a heading where it names one.

Exit code 1 if one is broken.
"""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from tools.tree import FOLDERS, ROOT, Module, modules, pages

FILE_LINES = 450
FUNCTION_LINES = 60
CRUMB_LINES = 80
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
ARITHMETIC = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.unaryop, ast.operator)
A_CLASS = "a class"
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"^ *```.*?^ *```|`[^`\n]*`", re.DOTALL | re.MULTILINE)


def sizes(known: dict[str, Module]) -> Iterator[str]:
    """Yield the files and functions that are too long."""
    for module in known.values():
        if module.lines > FILE_LINES:
            yield f"{module.path}: {module.lines} lines, the limit is {FILE_LINES}"
        for node in ast.walk(module.tree):
            if isinstance(node, FUNCTIONS):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                if lines > FUNCTION_LINES:
                    place = f"{module.path}:{node.lineno}: {node.name}"
                    yield f"{place} has {lines} lines, the limit is {FUNCTION_LINES}"


def doubles(known: dict[str, Module]) -> Iterator[str]:
    """Yield public classes of one name, and constants of one name with two numbers as values."""
    first: dict[str, tuple[str, Path]] = {}
    for module in known.values():
        for node in module.tree.body:
            for name, value in definitions(node):
                there, path = first.setdefault(name, (value, module.path))
                if path != module.path and (value != there or value == A_CLASS):
                    place = f"{module.path}:{node.lineno}: {name}"
                    yield f"{place} is {value}, in {path} {there}"


def definitions(node: ast.stmt) -> Iterator[tuple[str, str]]:
    """Yield name and value of a public class, and of public constants whose value is a number."""
    if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
        yield node.name, A_CLASS
    elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
        number = number_of(node.value)
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            name = target.id if isinstance(target, ast.Name) else "_"
            if number is not None and name.isupper() and not name.startswith("_"):
                yield name, number


def number_of(value: ast.expr) -> str | None:
    """Return a value that is a number, or arithmetic of numbers, as text; None for another one."""
    nodes = list(ast.walk(value))
    if not all(isinstance(node, ARITHMETIC) for node in nodes):
        return None
    constants = [node.value for node in nodes if isinstance(node, ast.Constant)]
    return ast.unparse(value) if all(type(each) in (int, float) for each in constants) else None


def structure(known: dict[str, Module]) -> Iterator[str]:
    """Yield an import cycle and the crumbs."""
    graph = {name: module.imports(known) for name, module in known.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        yield f"import cycle: {' -> '.join(error.args[1])}"
    importers: dict[str, list[str]] = defaultdict(list)
    for name, others in graph.items():
        for other in others:
            importers[other].append(name)
    for name, found in importers.items():
        module = known[name]
        is_package = module.path.stem in ("__init__", "__main__")
        if len(found) == 1 and module.lines < CRUMB_LINES and not is_package:
            yield f"{module.path}: {module.lines} lines that only {found[0]} imports"


def links(root: Path) -> Iterator[str]:
    """Yield the relative links that lead nowhere."""
    for page in pages(root):
        for target in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
            path, _, heading = target.partition("#")
            place = page.parent / path if path else page
            if "://" in target or target.startswith("mailto:"):
                continue
            if not place.exists():
                yield f"{page}: no file {target}"
            elif heading and heading not in headings(place):
                yield f"{page}: no heading {target}"


def headings(page: Path) -> set[str]:
    """Return the anchors that Markdown viewers give to the headings of a page."""
    found = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", each.lower()).replace(" ", "-") for each in found}


def findings(root: Path) -> Iterator[str]:
    """Yield every broken rule of a tree with its place."""
    production = modules(root)
    yield from sizes(modules(root, FOLDERS))
    yield from doubles(production)
    yield from structure(production)
    yield from links(root)


def main(root: Path = ROOT) -> int:
    """Print what is found and return the exit code."""
    found = [each.replace(f"{root}/", "") for each in findings(root)]
    for each in found:
        print(each)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
