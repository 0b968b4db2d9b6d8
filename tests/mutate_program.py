"""Mutation test of the controller's program: single steps changed in memory.

`python -m tests.mutate_program [--count N] [--seed S] [--jobs J]`. The file is never changed.
"""

import argparse
import multiprocessing
import os
import random
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from sim.as_language.errors import AsSyntaxError
from sim.as_language.parser import parse
from tests.fakes import controller_talk

TESTS = Path(__file__).resolve().parent / "unit" / "controller"
# Tests by the end of their file's name, and the parts whose changes they detect first.
ORDER = {
    "feedback": "step seed fresh ready gone pace",
    "commands": "take turn release angle jpace send", "limits": "judge", "signals": "signal",
    "messages": "recv hello", "watchdog": "watch halt", "faults": "tick frames",
    "life": "begin end.pc leave restore back main",
}  # fmt: skip
FILES = {name: TESTS / f"test_forcemesh_as_{name}.py" for name in ORDER}
NOTHING = ".zz=0"  # a step that does nothing
SWAPS = (
    (r"<>", "=="), (r"==", "<>"), (r"(?<!<)>(?!=)", "<="), (r"<(?![>=])", ">="),
    (r"\bAND\b", "OR"), (r"\bOR\b", "AND"), (r"(?<=[\w\])])\+(?=[\w.$])", "-"),
    (r"(?<=[\w\])])-(?=[\w.])", "+"), (r"(?<=[\w\])])\*(?=[\w.(])", "/"), (r"\[1\]", "[2]"),
    (r"\[2\]", "[3]"), (r"\[4\]", "[5]"), (r"\[6\]", "[4]"), (r"\bMINVAL\b", "MAXVAL"),
    (r"\bSIN\b", "COS"), (r"\bBREAK\b", NOTHING), (r"\bBRAKE\b", NOTHING),
    (r"^ *fm\.[\w.]+=.*$", NOTHING), (r"^ *CALL [\w.]+$", NOTHING), (r"\bJMOVE\b", "LMOVE"),
    (r"(?<![\w.])1(?![\w.])", "2"), (r"(?<![\w.])2(?![\w.])", "3"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Mutant:
    """One changed line."""

    part: str  # of the program, without "fm."
    line: int
    old: str
    new: str  # the control has no change

    def __str__(self) -> str:
        return f"{self.line:4d}: {self.old.strip()}  ->  {self.new.strip()}"

    def text(self) -> str:
        """The whole program with the change."""
        lines = controller_talk.TEXT.split("\n")
        lines[self.line - 1] = self.new
        return "\n".join(lines)


def mutants() -> Iterator[Mutant]:
    """Yield every possible change, in the order of the file, except in settings and set-up."""
    part = ""
    for number, line in enumerate(controller_talk.TEXT.split("\n"), 1):
        if line.startswith(".PROGRAM "):
            part = line.split()[1].removeprefix("fm.").split("(")[0]
        code = line.split(";", 1)[0].rstrip()
        if not code or code.startswith(".") or part in ("config", "init"):
            continue
        blank = re.sub(r'"[^"]*"', lambda found: '"' + "~" * (len(found[0]) - 2) + '"', code)
        for pattern, replacement in SWAPS:
            for found in re.finditer(pattern, blank):
                new = code[: found.start()] + replacement + code[found.end() :]
                yield Mutant(part, number, code, new)


def chosen(count: int, seed: int) -> list[Mutant]:
    """Return some mutants that the parser accepts, each of another line."""
    every, taken = list(mutants()), dict[int, Mutant]()
    random.Random(seed).shuffle(every)
    for mutant in every:
        if len(taken) < count and mutant.line not in taken:
            with suppress(AsSyntaxError):
                parse(mutant.text())
                taken[mutant.line] = mutant
    return [taken[line] for line in sorted(taken)]


def survives(mutant: Mutant) -> tuple[Mutant, bool]:
    """Run the tests against a mutant, in this process; return whether all of them pass."""
    os.environ["CI"] = "1"  # the same examples every time
    controller_talk.TEXT = mutant.text()
    sys.stdout = sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    names = sorted(ORDER, key=lambda name: mutant.part not in ORDER[name].split())
    files = [str(FILES[name]) for name in names]
    options = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not xfail", "--timeout", "120"]
    return mutant, pytest.main([*options, *files]) == pytest.ExitCode.OK


def main() -> int:
    """Report on a seeded choice; the exit code is the number of survivors."""
    parser = argparse.ArgumentParser()
    for name, default in (("--count", 80), ("--seed", 1), ("--jobs", 2)):
        parser.add_argument(name, type=int, default=default)
    arguments = parser.parse_args()
    work, survivors = chosen(arguments.count, arguments.seed), 0
    first = controller_talk.TEXT.split("\n", 1)[0]
    with multiprocessing.get_context("fork").Pool(arguments.jobs, maxtasksperchild=1) as pool:
        if not pool.apply(survives, [Mutant("", 1, first, first)])[1]:
            parser.error("the tests do not pass on the unchanged program")
        for mutant, survived in pool.imap(survives, work):
            survivors += survived
            print("SURVIVED" if survived else "killed  ", mutant, flush=True)  # noqa: T201
    print(f"{len(work) - survivors} of {len(work)} killed")  # noqa: T201
    return min(survivors, 100)


if __name__ == "__main__":
    sys.exit(main())
