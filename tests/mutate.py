"""Change single expressions of the modules that decide about motion; see what no test notices.

`make mutate`, or `python -m tests.mutate [MODULE ...] [--count N] [--seed S] [--since REF]`. No
file is touched: a forked process imports the changed text in the module's place and runs the
module's tests. Processes that tests start see the module as it is, so tests of real processes are
left out. A survivor that is listed in `tests/survivors.txt` with its reason is not one; a listed
one that is killed is told as well. The program of the controller has `tests.mutate_program`.

Exit code 0: no survivor that is not listed; 1: some; 2: wrong arguments, or the tests fail anyway.
"""

import argparse
import ast
import importlib.abc
import importlib.util
import itertools
import multiprocessing
import os
import random
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests"
SURVIVORS = TESTS / "survivors.txt"
LEAST_S, TIMES_LONGER = 60.0, 6.0  # what runs longer than both has been caught in a loop: killed
LOOSER = (1.6, 0.1)  # what a limit is multiplied by
PLAIN = (ast.Name, ast.Attribute, ast.Call)  # conditions that are no comparison

# Which tests judge a module, those most likely to see a change first.
JUDGES = {
    "common.permission": "unit/test_permission unit/test_two_arbiters",
    "common.guard": "unit/test_guard unit/test_guard_rules unit/test_pure_corners"
    " unit/test_back_off unit/test_guard_evil",
    "common.limits": "unit/test_limits unit/test_guard unit/test_pure_corners"
    " unit/test_arbiter_core",
    "common.motion_limits": "unit/test_limits_motion unit/test_limits_windows"
    " unit/test_arbiter_limits unit/test_pure_corners",
    "common.stream_budget": "unit/test_guard unit/test_guard_rules unit/test_pure_corners"
    " unit/test_guard_evil",
    "common.tracking": "unit/test_guard_tracking unit/test_faults_reached",
    "common.packet": "unit/test_packet unit/test_fuzz_codec",
    "common.packet_table": "unit/test_packet unit/test_controller_file unit/test_gateway_commands"
    " unit/test_gateway_limits",
    "common.reader": "unit/test_reader_bounds unit/test_endpoints unit/test_endpoints_rivals"
    " unit/test_two_arbiters",
    "common.acl": "unit/test_acl",
    "services.regulator.guards": "unit/test_regulator_guards unit/test_pure_corners"
    " unit/test_regulator_service",
    "services.regulator.oscillation": "unit/test_regulator_guards",
    "services.regulator.tuning": "unit/test_regulator_tuning unit/test_regulator_service"
    " unit/test_tune_advice",
    "services.arbiter.preflight": "unit/test_arbiter_preflight unit/test_arbiter_controller"
    " unit/test_arbiter_core",
    "services.arbiter.stops": "unit/test_arbiter_stops unit/test_arbiter_service",
    "services.arbiter.watch": "unit/test_arbiter_watch unit/test_arbiter_preflight"
    " unit/test_pure_corners unit/test_arbiter_health",
    "services.wrench.tare": "unit/test_wrench_tare",
    "services.wrench.plausibility": "unit/test_wrench_plausibility",
}
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
        """How it is listed."""
        return f"{self.module} {self.name}"


class Changes:
    """Every single change of one module's text."""

    def __init__(self, module: str, text: str) -> None:
        """Parse it."""
        self._module, self._text = module, text
        self._tree = ast.parse(text)
        lines = [0, *(found.end() for found in re.finditer("\n", text))]
        self._starts = lines  # of each line; the sources are ASCII, so columns are characters
        self._counts: dict[str, int] = {}

    def __iter__(self) -> Iterator[Mutant]:
        """Yield mutants in the order of the text, in functions and outside of them."""
        yield from self._within(self._tree, "")

    def _within(self, node: ast.AST, place: str) -> Iterator[Mutant]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.JoinedStr | ast.arguments) or child in _annotations(node):
                continue  # texts for people, types, defaults
            here = place
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                here = f"{place}.{child.name}" if place else child.name
            yield from self._of(child, here)
            yield from self._within(child, here)

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
        self, place: str, left: ast.expr, right: ast.expr, old: str, news: Sequence[str]
    ) -> Iterator[Mutant]:
        begin, end = self._end(left), self._start(right)
        at = self._text.find(old, begin, end)
        if at >= 0:
            shown = self._shown(left), self._shown(right)
            for new in news:
                what = f"{shown[0]} {old} {shown[1]} -> {new}"
                yield self._made(place, at, at + len(old), new, what)

    def _change(self, place: str, node: ast.AST, cut: int, new: str, what: str) -> Mutant:
        """Put something before a node, or cut off what it begins with."""
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
        """Return the line that a number or a name stands in, cut to what tells it apart."""
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
    """Tell whether a function has a value and a body that could be passed over."""
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
    return ROOT / f"{module.replace('.', '/')}.py"


def mutants_of(module: str) -> list[Mutant]:
    """Return every change of a module that can be compiled."""
    return [each for each in Changes(module, path_of(module).read_text()) if _compiles(each)]


def _compiles(mutant: Mutant) -> bool:
    try:
        compile(mutant.text, mutant.module, "exec")
    except (SyntaxError, ValueError):
        return False
    return True


# --- running the tests of one --------------------------------------------------------------------


class Instead(importlib.abc.MetaPathFinder):
    """Lets one module be imported from another text."""

    def __init__(self, mutant: Mutant) -> None:
        """Tell which one."""
        self._mutant = mutant

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return where the changed module comes from; of others nothing is known here."""
        if fullname != self._mutant.module:
            return None
        loader = ChangedText(fullname, str(path_of(fullname)), self._mutant.text)
        return importlib.util.spec_from_file_location(fullname, loader.path, loader=loader)


class ChangedText(SourceFileLoader):
    """Compiles a text instead of the file."""

    def __init__(self, fullname: str, path: str, text: str) -> None:
        """Keep the text."""
        super().__init__(fullname, path)
        self._text = text

    def get_code(self, _fullname: str) -> CodeType:
        """Return the code; nothing is read from or written to a cache."""
        return compile(self._text, self.path, "exec", dont_inherit=True)


def is_killed(mutant: Mutant) -> bool:
    """Run a module's tests on a mutant, in this process; tell whether one of them fails."""
    os.environ["CI"] = "1"  # the same examples every time
    sys.meta_path.insert(0, Instead(mutant))
    sys.stdout = sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    os.dup2(sys.stdout.fileno(), 1)
    os.dup2(sys.stdout.fileno(), 2)
    import pytest  # noqa: PLC0415 - after the finder is in place: it imports what is under test

    files = [str(TESTS / f"{name}.py") for name in JUDGES[mutant.module].split()]
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", "-p", "no:xdist"]
    chosen = ["-m", "not (realtime or processes or long)"]
    try:
        return pytest.main([*options, *chosen, *files]) != pytest.ExitCode.OK
    except BaseException:  # noqa: BLE001 - whatever it breaks, somebody sees it
        return True


def forked(mutant: Mutant, within_s: float) -> tuple[bool, float]:
    """Judge a mutant in a process of its own; return whether it is killed, and how long it took."""
    if mutant.module in sys.modules:
        raise RuntimeError(f"{mutant.module} is imported already: a change of it is not seen")
    began_s = time.monotonic()
    pid = os.fork()
    if pid == 0:
        os.setpgid(0, 0)
        os._exit(0 if is_killed(mutant) else 1)
    while time.monotonic() - began_s < within_s:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) != 1, time.monotonic() - began_s
        time.sleep(0.02)
    os.killpg(pid, 9)
    os.waitpid(pid, 0)
    return True, time.monotonic() - began_s


def judge(work: tuple[Mutant, float]) -> tuple[Mutant, bool]:
    """Return a mutant and whether it is killed."""
    mutant, within_s = work
    return mutant, forked(mutant, within_s)[0]


# --- the report ----------------------------------------------------------------------------------


def listed(path: Path = SURVIVORS) -> dict[str, str]:
    """Return the survivors that were looked at, and why each one may live."""
    rows = [row for row in path.read_text(encoding="utf-8").splitlines() if row.strip()]
    pairs = [row.split(" | ", 1) for row in rows if not row.startswith("#")]
    lacking = [pair[0] for pair in pairs if len(pair) == 1 or not pair[1].strip()]
    if lacking:
        raise ValueError(f"{path.name}: no reason after ' | ' for {lacking[0]}")
    return {title.strip(): reason.strip() for title, reason in pairs}


def changed_since(reference: str) -> list[str]:
    """Return the modules of the table whose files, or whose tests, a range of commits touches."""
    command = ["git", "diff", "--name-only", reference, "--"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    touched = set(done.stdout.splitlines())
    return [
        module
        for module, judges in JUDGES.items()
        if touched
        & {f"{module.replace('.', '/')}.py", *(f"tests/{name}.py" for name in judges.split())}
    ]


def chosen(modules: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """Return so many mutants of each module, drawn by a seed; 0: all of them."""
    work: list[Mutant] = []
    for module in modules:
        every = mutants_of(module)
        if 0 < count < len(every):
            places = sorted(random.Random(f"{seed} {module}").sample(range(len(every)), count))
            every = [every[at] for at in places]
        work += every
    return work


def limits_s(modules: Sequence[str]) -> dict[str, float]:
    """Return how long the tests of each module may take; exit where they fail unchanged."""
    limits = {}
    for module in modules:
        same = Mutant(module, "unchanged", path_of(module).read_text(encoding="utf-8"))
        killed, took_s = forked(same, 600.0)
        if killed:
            sys.stderr.write(f"the tests of {module} fail on the module as it is\n")
            raise SystemExit(2)
        limits[module] = max(LEAST_S, TIMES_LONGER * took_s)
    return limits


def report(
    results: Iterator[tuple[Mutant, bool]], known: dict[str, str], say: Callable[[str], object]
) -> int:
    """Say what became of each; return how many live that are not listed."""
    killed = alive = 0
    for mutant, is_dead in results:
        killed += is_dead
        if is_dead and mutant.title in known:
            say(f"killed, and listed as a survivor: {mutant.title}")
        elif not is_dead and mutant.title not in known:
            alive += 1
            say(f"SURVIVED {mutant.title}")
    say(f"{killed} killed, {alive} survived that are not listed")
    return alive


def main() -> int:
    """Report on a choice of mutants."""
    parser = argparse.ArgumentParser(prog="tests.mutate", description=__doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="all of the table by default")
    parser.add_argument("--count", type=int, default=0, help="of each module; 0: all")
    parser.add_argument("--seed", type=int, default=1, help="of the choice")
    parser.add_argument("--since", metavar="REF", help="modules changed since a commit alone")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    if unknown := set(given.modules) - set(JUDGES):
        parser.error(f"{min(unknown)} is not in the table: {', '.join(JUDGES)}")
    modules = changed_since(given.since) if given.since else given.modules or list(JUDGES)
    try:
        known = listed()
    except ValueError as error:
        parser.error(str(error))
    work = chosen(modules, given.count, given.seed)
    print(f"{len(work)} mutants of {len(modules)} modules", flush=True)  # noqa: T201
    within_s = limits_s(modules)
    with multiprocessing.get_context("fork").Pool(given.jobs) as pool:
        pairs = [(mutant, within_s[mutant.module]) for mutant in work]
        alive = report(pool.imap(judge, pairs), known, lambda line: print(line, flush=True))  # noqa: T201
    return min(alive, 1)


def preload() -> None:
    """Import before forking what is large and not ours; plugins are for pytest to import."""
    for name in ("lark", "mujoco", "msgpack", "pinocchio", "pydantic", "zenoh"):
        importlib.import_module(name)


if __name__ == "__main__":
    preload()
    sys.exit(main())
