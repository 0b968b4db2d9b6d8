"""Structure of the production code in numbers: tokens, lengths, importers, import cycles.

    python -m tools.structure            the numbers; fails above a limit
    python -m tools.structure --list     also the modules that are counted, and tokens by folder

- tokens: without docstrings, comments and layout;
- file: lines of the modules, `__init__.py` left out; body: lines of a function without signature
  and docstring;
- crumb: a module below 80 lines that exactly one other module imports;
- single: a module that exactly one other module imports; a row of a registry is not counted;
- cycle: modules that import each other, directly or over others, also under TYPE_CHECKING.
"""

import argparse
import ast
import statistics
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from tools.tree import ROOT, production_files

CRUMB_LINES = 80
# Modules that hold a table of others, each a row of it, with one importer by construction: verbs,
# sensor drivers, tabs of the panel, laws, statements of AS.
REGISTRIES = (
    "cli.__main__",
    "services.sensor.driver_registry",
    "services.panel.page",
    "services.regulator.laws",
    "sim.controller.compile",
)
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
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Module:
    """A production file, parsed."""

    name: str
    path: Path

    @cached_property
    def text(self) -> str:
        """The source."""
        return self.path.read_text(encoding="utf-8")

    @property
    def lines(self) -> int:
        """Number of lines."""
        return len(self.text.splitlines())

    @cached_property
    def tree(self) -> ast.Module:
        """The parsed source."""
        return ast.parse(self.text, filename=str(self.path))

    @property
    def tokens(self) -> int:
        """Number of tokens without docstrings, comments and layout."""
        docstrings = {
            node.body[0].lineno
            for node in ast.walk(self.tree)
            if isinstance(node, OWNERS) and ast.get_docstring(node, clean=False) is not None
        }
        with self.path.open("rb") as file:
            return sum(
                token.type not in LAYOUT
                and not (token.type == tokenize.STRING and token.start[0] in docstrings)
                for token in tokenize.tokenize(file.readline)
            )

    def bodies(self) -> Iterator[int]:
        """Yield the number of lines of each function without signature and docstring."""
        for node in ast.walk(self.tree):
            if isinstance(node, FUNCTIONS):
                body = node.body[1:] if ast.get_docstring(node) is not None else node.body
                if body:
                    yield (body[-1].end_lineno or body[-1].lineno) - body[0].lineno + 1

    def imports(self, known: dict[str, "Module"]) -> set[str]:
        """Return the modules of the project that this one imports."""
        found = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                found |= {name if name in known else node.module for name in inner}
        return (found & known.keys()) - {self.name}


def modules(root: Path = ROOT, paths: list[Path] | None = None) -> dict[str, Module]:
    """Return the production modules by dotted name."""
    found = {}
    for path in production_files() if paths is None else paths:
        parts = path.relative_to(root).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = Module(name, path)
    return found


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the groups of nodes that reach each other."""
    reached = {node: _reached(graph, node) for node in graph}
    groups = {
        tuple(sorted(other for other in others if node in reached[other]))
        for node, others in reached.items()
        if node in others
    }
    return [list(group) for group in sorted(groups)]


def _reached(graph: dict[str, set[str]], start: str) -> set[str]:
    found: set[str] = set()
    ahead = list(graph[start])
    while ahead:
        node = ahead.pop()
        if node not in found:
            found.add(node)
            ahead.extend(graph[node])
    return found


@dataclass(frozen=True)
class Structure:
    """The counted modules and their imports."""

    known: dict[str, Module]

    @cached_property
    def graph(self) -> dict[str, set[str]]:
        """The imports of each module."""
        return {name: module.imports(self.known) for name, module in self.known.items()}

    @cached_property
    def single(self) -> dict[str, str]:
        """The modules that exactly one other imports, with that one."""
        importers: dict[str, list[str]] = {name: [] for name in self.known}
        for name, others in self.graph.items():
            for other in others:
                importers[other].append(name)
        return {
            name: found[0]
            for name, found in importers.items()
            if len(found) == 1 and self.known[name].path.stem not in ("__init__", "__main__")
        }

    @property
    def crumbs(self) -> list[str]:
        """The modules below 80 lines that exactly one other imports."""
        return [name for name in self.single if self.known[name].lines < CRUMB_LINES]

    @property
    def single_share(self) -> float:
        """Share of the modules with one importer, rows of registries left out."""
        rows = {name for name, importer in self.single.items() if importer in REGISTRIES}
        return (len(self.single) - len(rows)) / (len(self.known) - len(rows))


def percentile(values: list[int], share: float) -> int:
    """Return the smallest value that at least a share of the values do not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def report(structure: Structure) -> Iterator[str]:
    """Yield the lines of the report."""
    found = list(structure.known.values())
    lines = [module.lines for module in found if module.path.stem != "__init__"]
    bodies = [body for module in found for body in module.bodies()]
    yield f"tokens: {sum(module.tokens for module in found)}"
    median, long = statistics.median(lines), percentile(lines, 0.95)
    yield f"files: {len(lines)}, median {median:.0f}, p95 {long}"
    yield f"functions: {len(bodies)}, body p95 {percentile(bodies, 0.95)}"
    yield f"crumbs: {structure.crumbs}"
    share = structure.single_share
    yield f"single: {len(structure.single)}, {share:.1%} without rows of registries"
    yield f"cycles: {[len(group) for group in cycles(structure.graph)]}"


def details(structure: Structure) -> Iterator[str]:
    """Yield the single modules, the cycles, and the tokens by folder."""
    for name, importer in structure.single.items():
        yield f"{structure.known[name].lines:4d} {name} <- {importer}"
    for group in cycles(structure.graph):
        yield f"cycle: {', '.join(group)}"
    tokens: Counter[str] = Counter()
    for name, module in structure.known.items():
        tokens[".".join(name.split(".")[:2])] += module.tokens
    for folder, count in tokens.most_common():
        yield f"{count:6d} tokens in {folder}"


def main(words: list[str]) -> int:
    """Print the report and return the exit code: not zero for a crumb or a cycle."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m tools.structure")
    parser.add_argument("--list", action="store_true", help="also what is counted")
    options = parser.parse_args(words)
    structure = Structure(modules())
    for line in report(structure):
        print(line)
    if options.list:
        for line in details(structure):
            print(line)
    return 1 if structure.crumbs or cycles(structure.graph) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
