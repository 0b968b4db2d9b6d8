"""Single changes of a module's text that a test must detect.

Limits, boundaries, rows of tables, comparisons, guards, calls and returns from a function. Types,
defaults of arguments and texts for people stay unchanged. `tests.mutate` judges them.
"""

import ast
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import takewhile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "controller" / "forcemesh.as"  # a module by its file's name
LOOSER = (1.6, 0.1)  # factors of a limit
PLAIN = (ast.Name, ast.Attribute, ast.Call)  # conditions that are no comparison

# The modules that decide about motion, and what stands between them and the controller.
MODULES = (
    "common.motion.arm_check",
    "common.motion.limits",
    "common.motion.permission",
    "common.motion.rate_limiter",
    "common.motion.setpoint_monitor",
    "common.motion.tracking",
    "common.motion.unexplained",
    "common.robot.driver",
    "common.robot.service",
    "common.security.access_control",
    "controller.packet",
    "controller.packet_table",
    "forcemesh.codec",
    "forcemesh.reader",
    "services.arbiter.preflight",
    "services.arbiter.stream",
    "services.arbiter.monitors",
    "control.monitors",
    "control.shape",
    "control.gain_rule",
    *sorted(
        f"services.{service}.{path.stem}"
        for service in ("gateway", "wrench")
        for path in (ROOT / "services" / service).glob("[a-z]*.py")
    ),
)
COMPARISONS = {
    "<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"),
    "==": ("!=",), "!=": ("==",), "is not": ("is",), "is": ("is not",),
    "not in": ("in",), "in": ("not in",),
}  # fmt: skip
OPERATORS: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of a module's text; the name does not depend on line numbers."""

    module: str
    name: str
    text: str

    @property
    def title(self) -> str:
        """The name in a list."""
        return f"{self.module} {self.name}"


class Changes:
    """Every single change of one module's text."""

    def __init__(self, module: str, text: str) -> None:
        """Parse the text."""
        self._module, self._text = module, text
        self._tree = ast.parse(text)
        lines = [0, *(found.end() for found in re.finditer("\n", text))]
        self._starts = lines  # of each line; the sources are ASCII, so columns are characters
        self._counts: dict[str, int] = {}

    def __iter__(self) -> Iterator[Mutant]:
        """Yield mutants in the order of the text, in functions and outside of them."""
        yield from self._mutants_of(self._tree, "")

    def _mutants_of(self, node: ast.AST, place: str) -> Iterator[Mutant]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.JoinedStr | ast.arguments) or child in _annotations(node):
                continue  # texts for people, types, defaults
            here = place
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                here = f"{place}.{child.name}" if place else child.name
            yield from self._of(child, here)
            yield from self._mutants_of(child, here)

    def _of(self, node: ast.AST, place: str) -> Iterator[Mutant]:
        yield from self._decisions(node, place)
        yield from self._sums(node, place)
        yield from self._values(node, place)
        yield from self._left_out(node, place)

    def _decisions(self, node: ast.AST, place: str) -> Iterator[Mutant]:
        match node:
            case ast.Compare():
                yield from self._comparisons(node, place)
            case ast.BoolOp():
                old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
                for left, right in itertools.pairwise(node.values):
                    yield from self._between(place, left, right, old, (new,))
            case ast.UnaryOp(op=ast.Not()):
                yield self._change(place, node, len("not "), "", "not left out")
            case ast.If() | ast.IfExp() if isinstance(node.test, PLAIN):
                yield self._change(place, node.test, 0, "not ", "negated")

    def _sums(self, node: ast.AST, place: str) -> Iterator[Mutant]:
        match node:
            case ast.BinOp() if type(node.op) in OPERATORS:
                old, new = OPERATORS[type(node.op)]
                yield from self._between(place, node.left, node.right, old, (new,))
            case ast.Call(func=ast.Name(id="min" | "max" as name)):
                yield self._replaced(place, node.func, "max" if name == "min" else "min")

    def _values(self, node: ast.AST, place: str) -> Iterator[Mutant]:
        match node:
            case ast.Constant(value=bool(value)):
                yield self._replaced(place, node, str(not value))
            case ast.Constant(value=int(value)):
                yield self._replaced(place, node, str(value + 1))
            case ast.Constant(value=float(value)):
                for by in LOOSER if value else (1.0,):
                    yield self._replaced(place, node, f"{value * by or by:.6g}")

    def _left_out(self, node: ast.AST, place: str) -> Iterator[Mutant]:
        match node:
            case ast.FunctionDef() if _gives_something(node):
                first = node.body[1 if ast.get_docstring(node) else 0]
                before = f"return None\n{' ' * first.col_offset}"
                yield self._change(place, first, 0, before, "returns None")
            case ast.Expr(value=ast.Call()):
                yield self._replaced(place, node, "pass")
            case ast.Tuple() | ast.List() if len(node.elts) > 1 and _spans_lines(node):
                for row in node.elts:
                    yield self._dropped(place, row)
            case ast.Dict() if len(node.values) > 1 and _spans_lines(node):
                for key, row in zip(node.keys, node.values, strict=True):
                    if key is not None:
                        yield self._dropped(place, row, key)

    def _comparisons(self, node: ast.Compare, place: str) -> Iterator[Mutant]:
        sides = [node.left, *node.comparators]
        for left, right in itertools.pairwise(sides):
            between = self._text[self._end(left) : self._start(right)]
            old = next((each for each in COMPARISONS if each == between.strip(" \n()")), "")
            if old:
                yield from self._between(place, left, right, old, COMPARISONS[old])

    def _between(
        self, place: str, left: ast.expr, right: ast.expr, old: str, replacements: Sequence[str]
    ) -> Iterator[Mutant]:
        begin, end = self._end(left), self._start(right)
        at = self._text.find(old, begin, end)
        if at >= 0:
            shown = self._shown(left), self._shown(right)
            for new in replacements:
                what = f"{shown[0]} {old} {shown[1]} -> {new}"
                yield self._made(place, at, at + len(old), new, what)

    def _change(self, place: str, node: ast.AST, cut: int, new: str, what: str) -> Mutant:
        """Insert a text before a node, or remove a number of its first characters."""
        at = self._start(node)
        shown = "" if new.startswith("return") else f"{self._shown(node)} "
        return self._made(place, at, at + cut, new, f"{shown}{what}")

    def _replaced(self, place: str, node: ast.AST, new: str) -> Mutant:
        what = f"{self._context(node)} -> {new}"
        return self._made(place, self._start(node), self._end(node), new, what)

    def _dropped(self, place: str, row: ast.expr, key: ast.expr | None = None) -> Mutant:
        begin, end = self._start(key or row), self._end(row)
        comma = re.compile(r"\s*,").match(self._text, end)
        if comma:
            end = comma.end()
        return self._made(place, begin, end, "", f"{self._shown(key or row)} left out")

    def _made(self, place: str, begin: int, end: int, new: str, what: str) -> Mutant:
        text = self._text[:begin] + new + self._text[end:]
        name = f"{place or 'module'}: {what}"
        self._counts[name] = count = self._counts.get(name, 0) + 1
        return Mutant(self._module, name if count == 1 else f"{name} ({count})", text)

    def _context(self, node: ast.AST) -> str:
        """Return the line of a number or a name, cut to a length that identifies it."""
        begin = self._start(node)
        line = self._text[self._text.rfind("\n", 0, begin) + 1 :].split("\n", 1)[0]
        shown = self._shown(node)
        return f"{shown} in {' '.join(line.split('#')[0].split())[:70]}"

    def _shown(self, node: ast.AST) -> str:
        return " ".join(self._text[self._start(node) : self._end(node)].split())[:48]

    def _start(self, node: ast.AST) -> int:
        return self._starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]

    def _end(self, node: ast.AST) -> int:
        return self._starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]


def _annotations(node: ast.AST) -> tuple[ast.AST | None, ...]:
    match node:
        case ast.AnnAssign():
            return (node.annotation,)
        case ast.FunctionDef():
            return (node.returns, *node.decorator_list)
        case ast.ClassDef():
            return tuple(node.decorator_list)
    return ()


def _gives_something(node: ast.FunctionDef) -> bool:
    """Return whether a function has a value and a body that a return could skip."""
    returns = node.returns
    gives = returns is not None and not (
        isinstance(returns, ast.Constant) and returns.value is None
    )
    body = node.body[1:] if ast.get_docstring(node) else node.body
    return gives and bool(body) and not any(isinstance(e, ast.Yield) for e in ast.walk(node))


def _spans_lines(node: ast.expr) -> bool:
    return node.end_lineno is not None and node.end_lineno > node.lineno


def path_of(module: str) -> Path:
    """Return the file of a module."""
    if module == PROGRAM.name:
        return PROGRAM
    return ROOT / f"{module.replace('.', '/')}.py"


def line_of(mutant: Mutant) -> int:
    """Return the line of the change, from 1."""
    old = path_of(mutant.module).read_text()
    same = takewhile(lambda pair: pair[0] == pair[1], zip(old, mutant.text, strict=False))
    return sum(char == "\n" for char, _ in same) + 1


@cache
def mutants_of(module: str) -> list[Mutant]:
    """Return every change of a module that can be compiled."""
    return [each for each in Changes(module, path_of(module).read_text()) if _compiles(each)]


def _compiles(mutant: Mutant) -> bool:
    try:
        compile(mutant.text, mutant.module, "exec")
    except (SyntaxError, ValueError):
        return False
    return True
