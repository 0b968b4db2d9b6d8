"""Mutation test: changes of what decides about motion that no test detects.

`python -m tests.mutate [MODULE ...] [--count N] [--seed S]`, or `--program` for the controller's.
First all tests that need no real time run once with coverage: this map tells which test executes
which line, and for how long. Then on each mutant the tests that execute its line run, the shortest
first, until one fails; with `--all` the others run too: the kill matrix. Map and journal belong to
a state of the tree, and an interrupted run continues behind the journal's last line. `--tests
tests/unit/x` lets only the tests there judge.

A change within a function replaces the code of the function in a forked process that has imported
everything. A change outside of functions, and one that this does not detect, is judged in a new
process that imports the changed text. No file is changed. Processes that tests start import the
unchanged module, so tests of real processes are left out.

A survivor that is listed in `tests/mutate/survivors.txt` with its reason is accepted; a listed one
that is killed is reported as well. Exit code 0: no survivor that is not listed; 1: some; 2: wrong
arguments, or tests that fail without a mutant.
"""

import argparse
import importlib
import json
import os
import random
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from zlib import crc32

import pytest

from tests.hazards import planted
from tests.mutate.judge import Judge, Verdict, verdicts
from tests.mutate.mutations import MODULES, Mutant, mutants_of
from tests.mutate.planting import MUTANTS, NewProcess
from tests.mutate.reached import OPTIONS, Reached
from tools.nightly import git
from tools.tree import ROOT

SURVIVORS = Path(__file__).with_name("survivors.txt")


def listed(path: Path = SURVIVORS) -> dict[str, str]:
    """Return the reviewed survivors, each with its reason."""
    rows = [row for row in path.read_text(encoding="utf-8").splitlines() if row.strip()]
    pairs = [row.split(" | ", 1) for row in rows if not row.startswith("#")]
    lacking = [pair[0] for pair in pairs if len(pair) == 1 or not pair[1].strip()]
    if lacking:
        raise ValueError(f"{path.name}: no reason after ' | ' for {lacking[0]}")
    return {title.strip(): reason.strip() for title, reason in pairs}


def chosen(modules: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """Return this number of mutants of each module, drawn by a seed; 0: all of them."""
    work: list[Mutant] = []
    for module in modules:
        every = mutants_of(module)
        if 0 < count < len(every):
            places = sorted(random.Random(f"{seed} {module}").sample(range(len(every)), count))
            every = [every[at] for at in places]
        work += every
    return work


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


def report(found: Iterable[Verdict], known: dict[str, str]) -> tuple[list[str], int]:
    """Return the lines to print, and the number of survivors that are not listed."""
    lines, killed, survivors = [], 0, 0
    for verdict in found:
        killed += bool(verdict.killed_by)
        if verdict.killed_by and verdict.mutant in known:
            lines.append(f"killed, and listed as a survivor: {verdict.mutant}")
        elif not verdict.killed_by and verdict.mutant not in known:
            survivors += 1
            lines.append(f"SURVIVED {verdict.mutant}")
    return [*lines, f"{killed} killed, {survivors} survived that are not listed"], survivors


def mapped(
    parser: argparse.ArgumentParser, tests: Sequence[str], jobs: int
) -> tuple[Reached, Path]:
    """Return the map of tests for the tree as it is, made if there is none, and its folder."""
    choice = re.sub(r"\W+", "-", " ".join(tests))
    changes = crc32((git("diff", "HEAD") + git("status", "--porcelain")).encode())
    state = f"{git('rev-parse', '--short=10', 'HEAD')}-{changes:08x}"
    folder = ROOT / "out" / "kills" / state / choice
    reached, complete = Reached(folder), folder / "complete"
    if not complete.exists():
        if reached.make(tests, jobs) != pytest.ExitCode.OK:
            parser.error("the tests fail without a mutant")
        complete.touch()
    reached.read()
    return reached, folder


def main() -> int:
    """Judge a choice of mutants; return the exit code."""
    parser = argparse.ArgumentParser(prog="tests.mutate", description=__doc__)
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="all of the table by default")
    parser.add_argument("--planted", action="store_true", help="judge the planted changes")
    parser.add_argument("--program", action="store_true", help="judge the controller's program")
    parser.add_argument("--all", action="store_true", help="run the other tests as well")
    parser.add_argument("--tests", nargs="+", default=["tests"], metavar="PATH", help="that judge")
    parser.add_argument("--count", type=int, default=0, help="of each module; 0: all")
    seed = int(git("rev-parse", "--short=10", "HEAD"), 16)  # other mutants on each commit
    parser.add_argument("--seed", type=int, default=seed, help="by default of the commit")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--in-new-process", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    os.environ["CI"] = "1"  # the same examples every time
    if given.in_new_process is not None:
        NewProcess(**json.load(sys.stdin)).main(given.in_new_process)
        return 0
    if unknown := set(given.modules) - set(MODULES):
        parser.error(f"{min(unknown)} is not in the table: {', '.join(MODULES)}")
    reached, folder = mapped(parser, given.tests, given.jobs)
    preload()
    if given.planted:
        work = planted_changes()
    elif given.program:
        from tests.mutate import program  # noqa: PLC0415 - a new process imports nothing of it

        work = program.chosen(given.count, given.seed)
    else:
        work = chosen(given.modules or MODULES, given.count, given.seed)
    journal = folder / ("matrix.jsonl" if given.all else "verdicts.jsonl")
    judge = Judge(work, reached, journal, given.jobs, every=given.all)
    pytest.main([*OPTIONS, *MUTANTS, *given.tests], plugins=[judge])
    titles = {mutant.title for mutant in work}
    found = [verdict for verdict in verdicts(journal) if verdict.mutant in titles]
    lines, survivors = report(found, listed())
    sys.stdout.write("\n".join([*lines, ""]))
    return 2 if len(found) < len(titles) else min(survivors, 1)


def preload() -> None:
    """Import large packages of others before the fork, except plugins, which pytest imports."""
    for name in ("lark", "mujoco", "msgpack", "msgspec", "pinocchio", "pydantic", "zenoh"):
        importlib.import_module(name)


if __name__ == "__main__":
    sys.exit(main())
