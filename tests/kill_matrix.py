"""Kill matrix: which tests detect which mutant.

`python -m tests.kill_matrix map` runs all tests that need no real time once, and stores which test
executes which line, and for how long. `python -m tests.kill_matrix judge [MODULE ...]` then runs,
on each mutant, the tests that execute its line, shortest first, and appends those that fail to a
journal; an interrupted run continues behind the last line.

A change within a function replaces the code of the function in a forked process that has imported
everything. A change outside of functions, and one that this does not detect, is judged in a new
process that imports the changed text.
"""

import argparse
import gc
import inspect
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import takewhile
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from xml.etree import ElementTree as ET

import coverage
import pytest

from tests.hazards import planted
from tests.mutate import Instead, chosen, preload
from tests.mutations import JUDGES, Mutant, path_of
from tools.tree import PRODUCTION, ROOT

FOLDER = ROOT / "out" / "kills"
PROGRAM = ROOT / "controller" / "forcemesh.as"
MAP, DURATIONS = FOLDER / "map", FOLDER / "durations.xml"
HANGS = "a test that does not end"
OPTIONS = ("-q", "-p", "no:cacheprovider", "-m", "not (realtime or processes or long)")
MUTANTS = ("-p", "no:xdist", "--hypothesis-profile", "mutants")
MOST_S = 15.0  # of tests on one mutant
MOST_UNTIL_KILLED_S = 120.0  # of tests on a mutant that none of the first ones detects
SURPLUS_S, TIMES_LONGER = 10.0, 6.0  # a test that takes longer than both together hangs
MODULES = tuple(
    sorted(
        set(JUDGES)
        | {"forcemesh.codec"}
        | {
            ".".join(path.relative_to(ROOT).with_suffix("").parts)
            for folder in ("gateway", "wrench")
            for path in (ROOT / "services" / folder).glob("[a-z]*.py")
        }
    )
)


@dataclass(frozen=True, slots=True)
class Verdict:
    """One line of the journal: tests without their parameters."""

    mutant: str
    line: int
    killed_by: Sequence[str]
    not_run: int  # tests that reach the line too, but the time was over


def function_of(nodeid: str) -> str:
    """Return a test without its parameters."""
    return nodeid.split("[", 1)[0]


def line_of(mutant: Mutant) -> int:
    """Return the line of the change, from 1."""
    path = PROGRAM if mutant.module == PROGRAM.name else path_of(mutant.module)
    old = path.read_text()
    same = takewhile(lambda pair: pair[0] == pair[1], zip(old, mutant.text, strict=False))
    return sum(char == "\n" for char, _ in same) + 1


# --- the map -------------------------------------------------------------------------------------


def make_map(jobs: int) -> int:
    """Run the tests once with coverage; return the exit code."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    settings = FOLDER / "coveragerc"
    folders = "\n".join(f"    {folder}/*" for folder in PRODUCTION)
    settings.write_text(f"[run]\nbranch = false\ndata_file = {MAP}\ninclude =\n{folders}\n")
    command = [
        *(sys.executable, "-m", "pytest", *OPTIONS, "-n", str(jobs), "-o", "timeout=900"),
        *("--hypothesis-profile", "mutants", "--cov", f"--cov-config={settings}"),
        *("--cov-context=test", "--cov-report=", f"--junitxml={DURATIONS}"),
    ]
    return subprocess.run(command, cwd=ROOT, env=os.environ | {"CI": "1"}, check=False).returncode


def durations() -> dict[str, float]:
    """Return how long each test took [s], by its id."""
    found = {}
    for case in ET.parse(DURATIONS).iter("testcase"):  # noqa: S314 - written by ourselves
        path = case.attrib["classname"].replace(".", "/")
        found[f"{path}.py::{case.attrib['name']}"] = float(case.attrib["time"])
    return found


class Reached:
    """The tests that execute each line of each module."""

    def __init__(self) -> None:
        self._data = coverage.CoverageData(str(MAP))
        self._data.read()

    @cache  # noqa: B019 - one object, for the whole run
    def lines(self, module: str) -> dict[int, set[str]]:
        """Return the tests of each line."""
        found = self._data.contexts_by_lineno(str(path_of(module)))
        return {
            line: {context.rsplit("|", 1)[0] for context in contexts if context}
            for line, contexts in found.items()
        }

    def by(self, mutant: Mutant) -> set[str]:
        """Return the tests that execute a mutant's line, or any of its module if no test does."""
        if mutant.module == PROGRAM.name:
            every = set().union(*self.lines("sim.controller.machine").values())
            return {each for each in every if not each.startswith("tests/unit/sim/")}
        lines = self.lines(mutant.module)
        return lines.get(line_of(mutant)) or set().union(*lines.values())


# --- one mutant ----------------------------------------------------------------------------------


class Kills:
    """Plugin that reports each test that fails, and runs no test whose function failed already."""

    def __init__(self, write: int, longest_s: dict[str, float]) -> None:
        self._write, self._longest_s = write, longest_s
        self.functions: set[str] = set()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Bound the time of each test."""
        for item in items:
            longest_s = SURPLUS_S + TIMES_LONGER * self._longest_s.get(item.nodeid, 1.0)
            item.add_marker(pytest.mark.timeout(longest_s), append=False)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Report a failure."""
        if report.failed:
            self._kill(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Report a module that can't be imported."""
        if report.failed:
            self._kill(report.nodeid)

    def _kill(self, nodeid: str) -> None:
        function = function_of(nodeid)
        if function not in self.functions:
            self.functions.add(function)
            os.write(self._write, f"{function}\n".encode())


def silence() -> None:
    """Discard what tests print."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)


def codes_of(code: CodeType) -> Iterator[CodeType]:
    """Yield the code of each function of a module and its classes."""
    for each in code.co_consts:
        if isinstance(each, CodeType):
            if each.co_flags & inspect.CO_NEWLOCALS:
                yield each
            else:
                yield from codes_of(each)


def differs(a: CodeType, b: CodeType) -> bool:
    """Return whether two functions do something else."""
    return (a.co_code, a.co_consts, a.co_names) != (b.co_code, b.co_consts, b.co_names)


class Functions:
    """Functions of the modules in this process, whose code can be replaced."""

    def __init__(self, modules: Iterable[str]) -> None:
        self._found: dict[tuple[str, str, int], list[FunctionType]] = defaultdict(list)
        files = {str(path_of(module)) for module in modules}
        gc.unfreeze()  # what is frozen is not among the objects
        for each in gc.get_objects():
            if isinstance(each, FunctionType) and each.__code__.co_filename in files:
                code = each.__code__
                key = (code.co_filename, code.co_qualname, code.co_firstlineno)
                self._found[key].append(each)

    def change(self, mutant: Mutant) -> bool:
        """Replace the code that a mutant changes; return False for one that only an import runs."""
        path = str(path_of(mutant.module))
        old = compile(path_of(mutant.module).read_text(), path, "exec", dont_inherit=True)
        new = compile(mutant.text, path, "exec", dont_inherit=True)
        # An inserted line moves what follows, so only the first difference is the mutant's.
        for was, becomes in zip(codes_of(old), codes_of(new), strict=True):
            if differs(was, becomes):
                key = path, was.co_qualname, was.co_firstlineno
                for function in self._found[key]:
                    function.__code__ = becomes
                return bool(self._found[key])
        return False


def change_program(text: str) -> None:
    """Put a changed program of the controller in the place of the shipped one, in this process."""
    from tests.fakes import controller_talk  # noqa: PLC0415 - a new process imports nothing of it

    shipped, read = controller_talk.TEXT, Path.read_text
    gc.unfreeze()  # what is frozen is not among the objects
    for each in gc.get_objects():
        if isinstance(each, ModuleType):
            for name in [name for name, value in vars(each).items() if value is shipped]:
                setattr(each, name, text)
        elif isinstance(each, FunctionType):
            defaults = each.__kwdefaults__ or {}
            defaults.update({name: text for name in defaults if defaults[name] is shipped})
    Path.read_text = lambda path, *words, **more: (  # type: ignore[method-assign]
        text if path.name == PROGRAM.name else read(path, *words, **more)
    )


def run_items(session: pytest.Session, items: Sequence[pytest.Item], kills: Kills) -> None:
    """Run tests, without those whose function has failed with other parameters."""
    state = session._setupstate  # pytest has no public way to leave out a test
    for number, item in enumerate(items):
        if function_of(item.nodeid) in kills.functions:
            continue
        following = items[number + 1] if number + 1 < len(items) else None
        state.teardown_exact(item)
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)


def in_new_process(mutant: Mutant, took_s: dict[str, float], write: int) -> None:
    """Run tests in this process, which has imported nothing of the product, on a changed text."""
    sys.meta_path.insert(0, Instead(mutant))
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
        file.write("\n".join(took_s))
        file.flush()
        pytest.main([*OPTIONS, *MUTANTS, f"@{file.name}"], plugins=[Kills(write, took_s)])


def planted_changes() -> list[Mutant]:
    """Return the planted changes of the hazards in Python as mutants."""
    return [
        Mutant(
            change.file.removesuffix(".py").replace("/", "."),
            f"{change.hazard} {change.old}",
            change.fitted(ROOT),
        )
        for change in planted()
        if change.file.endswith(".py")
    ]


# --- all mutants ---------------------------------------------------------------------------------


@dataclass(slots=True)
class Job:
    """A mutant in work: its tests, those left, the process, and what that has reported."""

    mutant: Mutant
    tests: list[str]
    left: list[str]
    stage: int = 0  # 0: in a fork, 1: in a new process, 2: the longer tests there
    pid: int = 0
    ends_s: float = 0.0
    text: bytes = b""


class Judge:
    """Plugin that, in place of running the tests once, runs them on each mutant."""

    def __init__(self, work: Sequence[Mutant], journal: Path, jobs: int) -> None:
        self._journal, self._jobs = journal, jobs
        lines = journal.read_text(encoding="utf-8").splitlines() if journal.is_file() else []
        done = {json.loads(line)["mutant"] for line in lines}
        self._work = [mutant for mutant in work if mutant.title not in done]
        self._took_s, self._reached = durations(), Reached()
        self._running: dict[int, Job] = {}  # by the end of the pipe that is read

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Judge all mutants."""
        self._session = session
        self._items = {item.nodeid: item for item in session.items}
        self._place = {item.nodeid: place for place, item in enumerate(session.items)}
        modules = {mutant.module for mutant in self._work} - {PROGRAM.name}
        self._functions = Functions(modules)
        gc.collect()
        gc.freeze()
        for number, mutant in enumerate(self._work, 1):
            while len(self._running) >= self._jobs:
                self._wait()
            self._fork(Job(mutant, *self._split(self._reached.by(mutant), MOST_S)))
            print(f"{number} of {len(self._work)}: {mutant.title}", file=sys.__stderr__, flush=True)
        while self._running:
            self._wait()
        return True

    def _split(self, ids: Iterable[str], most_s: float) -> tuple[list[str], list[str]]:
        """Return the shortest tests, in the order of their files, and the others."""
        known = [each for each in ids if each in self._items]
        known.sort(key=lambda each: (self._took_s.get(each, 1.0), each))
        total_s, count = 0.0, 0
        while (
            count < len(known)
            and (total_s := total_s + self._took_s.get(known[count], 1.0)) < most_s
        ):
            count += 1
        count = max(count, min(1, len(known)))
        return sorted(known[:count], key=self._place.__getitem__), known[count:]

    def _fork(self, job: Job) -> None:
        read, write = os.pipe()
        job.pid = os.fork()
        if job.pid == 0:
            os.setpgid(0, 0)
            os.close(read)
            try:
                silence()
                self._child(job, write)
            finally:
                os._exit(0)
        os.close(write)
        expected_s = sum(self._took_s.get(each, 1.0) for each in job.tests)
        job.ends_s = time.monotonic() + 60.0 + TIMES_LONGER * expected_s
        self._running[read] = job

    def _child(self, job: Job, write: int) -> None:
        if job.mutant.module == PROGRAM.name:
            change_program(job.mutant.text)
        elif job.stage or not self._functions.change(job.mutant):
            took_s = {each: self._took_s.get(each, 1.0) for each in job.tests}
            work = json.dumps([job.mutant.module, job.mutant.name, job.mutant.text, took_s])
            command = [sys.executable, "-m", "tests.kill_matrix", "one", str(write)]
            subprocess.run(command, cwd=ROOT, pass_fds=[write], input=work, text=True, check=False)
            return
        kills = Kills(write, self._took_s)
        items = [self._items[each] for each in job.tests]
        kills.pytest_collection_modifyitems(items)
        self._session.config.pluginmanager.register(kills)
        run_items(self._session, items, kills)

    def _wait(self) -> None:
        """Take what the processes report; end those that take too long."""
        for read in select.select(list(self._running), [], [], 1.0)[0]:
            if piece := os.read(read, 65536):
                self._running[read].text += piece
            else:
                self._end(read)
        for read, job in list(self._running.items()):
            if time.monotonic() > job.ends_s:
                os.killpg(job.pid, signal.SIGKILL)
                job.text += f"{HANGS}\n".encode()
                self._end(read)

    def _end(self, read: int) -> None:
        job = self._running.pop(read)
        os.close(read)
        os.waitpid(job.pid, 0)
        killers = sorted(set(job.text.decode().split("\n")) - {""})
        is_program = job.mutant.module == PROGRAM.name
        if (
            not killers and job.stage == 0 and not is_program
        ):  # a table made at the import may hold the change
            self._fork(replace(job, stage=1, text=b""))
        elif not killers and job.left and job.stage == 1:
            tests, left = self._split(job.left, MOST_UNTIL_KILLED_S)
            self._fork(Job(job.mutant, tests, left, stage=2))
        else:
            verdict = Verdict(job.mutant.title, line_of(job.mutant), killers, len(job.left))
            with self._journal.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(verdict)) + "\n")


def main() -> int:
    """Make the map, or judge; return the exit code."""
    parser = argparse.ArgumentParser(prog="tests.kill_matrix", description=__doc__)
    parser.add_argument("what", choices=("map", "judge", "one"))
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="all by default")
    parser.add_argument("--hazards", action="store_true", help="judge the planted changes")
    parser.add_argument("--program", action="store_true", help="judge the controller's program")
    parser.add_argument("--count", type=int, default=0, help="of each module; 0: all")
    parser.add_argument("--seed", type=int, default=1, help="of the choice")
    parser.add_argument("--journal", type=Path, default=FOLDER / "matrix.jsonl")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    os.environ["CI"] = "1"  # the same examples every time
    if given.what == "map":
        return make_map(given.jobs)
    if given.what == "one":
        module, name, text, took_s = json.load(sys.stdin)
        in_new_process(Mutant(module, name, text), took_s, int(given.modules[0]))
        return 0
    preload()
    if given.hazards:
        work = planted_changes()
    elif given.program:
        from tests import mutate_program  # noqa: PLC0415 - as above

        every = mutate_program.chosen(given.count, given.seed)
        work = [Mutant(PROGRAM.name, str(each), each.text()) for each in every]
    else:
        work = chosen(given.modules or MODULES, given.count, given.seed)
    judge = Judge(work, given.journal, given.jobs)
    return pytest.main([*OPTIONS, *MUTANTS, str(ROOT / "tests")], plugins=[judge])


if __name__ == "__main__":
    sys.exit(main())
