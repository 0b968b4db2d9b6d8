"""Proof of docs/hazards.md: with the control of a hazard removed, a named test of its row fails.

`python -m tests.hazards [H12 ...] [--journal FILE]`. The planted changes are the lines of
`tests/hazards.txt`: hazard, file, its text, and the text that removes the control, or plants the
wrong use where the control is an absence. Each is made in a copy of the tree, in which the tests
that the row names run, except those in real time.

Exit code 0: every change is found; 1: one is not; 2: wrong arguments, a change that does not fit
the file, or tests that fail without a change.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tools.tree import ROOT, copy_of_the_tree

PAGE = ROOT / "docs" / "hazards.md"
PLANTED = ROOT / "tests" / "hazards.txt"
UNCHANGED = "the unchanged tree"
NO_CHANGE = re.compile(r"no planted change: \S.*")
# Exit codes of pytest. All others, as of a module that cannot be imported, are no verdict.
PASSED, FAILED = 0, 1
LONGEST_S = 900.0  # for the tests of a row; a change that lets them hang is found
OPTIONS = (
    *("-x", "-q", "--hypothesis-profile", "mutants", "-m", "not (realtime or processes or long)"),
    *("-p", "no:cacheprovider", "-p", "no:randomly", "-p", "no:xdist", "-o", "timeout=600"),
)


class Planted(NamedTuple):
    """One planted change: the control of a hazard removed from a file."""

    hazard: str
    file: str
    old: str
    new: str

    def fitted(self, root: Path) -> str:
        """Return the changed text of the file. Raises ValueError unless it fits exactly once."""
        text = (root / self.file).read_text(encoding="utf-8")
        if (count := text.count(self.old)) != 1:
            raise ValueError(f"{self.hazard}: {self.file} has {count} times, not once: {self.old}")
        return text.replace(self.old, self.new)


def rows() -> dict[str, str]:
    """Return the last column of each hazard's row: its proof."""
    page = PAGE.read_text(encoding="utf-8")
    return dict(re.findall(r"^\| (H\d\d) \|.*\| (.*) \|$", page, re.MULTILINE))


def named_tests(proof: str) -> list[str]:
    """Return the tests that a row names, as pytest takes them."""
    return [f"tests/{name}" for name in re.findall(r"`([a-z_/]+\.py(?:::test_\w+)?)`", proof)]


def planted() -> list[Planted]:
    """Return the planted changes. Raises ValueError for a line of another form."""
    changes = []
    for line in PLANTED.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            found = re.fullmatch(r"(H\d\d) (\S+): (.+?)  ==>(?:  |$)(.*)", line)
            if found is None:
                raise ValueError(f"{PLANTED.name}: no `HAZARD FILE: OLD  ==>  NEW`: {line}")
            hazard, file, old, new = (part.replace("\\n", "\n") for part in found.groups())
            changes.append(Planted(hazard, file, old, new))
    return changes


def verdict(folder: Path, tests: Sequence[str], **variables: str) -> int:
    """Run tests in a copy of the tree; return the exit code of pytest."""
    environment = {**os.environ, "CI": "1", "PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "pytest", *OPTIONS, *tests]
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment | variables, capture_output=True, text=True,
            check=False, timeout=LONGEST_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return FAILED
    if done.returncode not in (PASSED, FAILED if variables else PASSED):
        sys.stderr.write(done.stdout[-3000:] + done.stderr[-3000:])
    return done.returncode


class Journal:
    """Journal of the changes that were found at the present commit; it lets a run be resumed."""

    def __init__(self, path: Path | None) -> None:
        """Read the file, if there is one."""
        head = ["git", "rev-parse", "HEAD"]
        done = subprocess.run(head, cwd=ROOT, capture_output=True, text=True, check=True)
        self._path, self._commit = path, done.stdout.strip()
        lines = path.read_text(encoding="utf-8").splitlines() if path and path.is_file() else []
        self._found = [json.loads(line) for line in lines]

    def has(self, *entry: str) -> bool:
        """Return whether this was found at this commit."""
        return [self._commit, *entry] in self._found

    def add(self, *entry: str) -> None:
        """Append what was found."""
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([self._commit, *entry]) + "\n")


def judge(folder: Path, change: Planted, tests: Sequence[str]) -> int:
    """Return the exit code of the tests of a hazard under its change."""
    path, kept = folder / change.file, folder / "kept"
    path.rename(kept)
    path.write_text(change.fitted(ROOT), encoding="utf-8")
    try:  # bytecode of a changed file must not outlive it
        return verdict(folder, tests, PYTHONDONTWRITEBYTECODE="1")
    finally:
        kept.replace(path)


def run(changes: Sequence[Planted], journal: Journal, folder: Path) -> int:
    """Judge changes in a copy of the tree; print a line for each, return the exit code."""
    tests = {hazard: named_tests(proof) for hazard, proof in rows().items()}
    every = sorted({test for change in changes for test in tests[change.hazard]})
    if not journal.has(UNCHANGED, *every):
        if verdict(folder, every) != PASSED:
            sys.stderr.write("the tests fail without a planted change\n")
            return 2
        journal.add(UNCHANGED, *every)
    missed = 0
    for change in changes:
        if not journal.has(*change):
            code = judge(folder, change, tests[change.hazard])
            if code != FAILED:
                missed += 1
                why = "NOT FOUND" if code == PASSED else f"NO VERDICT, pytest ended with {code}"
                print(f"{why}: {change.hazard} {change.file}: {change.old}", flush=True)  # noqa: T201
                continue
            journal.add(*change)
        print(f"found {change.hazard} {change.file}: {change.old}", flush=True)  # noqa: T201
    print(f"{len(changes) - missed} of {len(changes)} planted changes are found")  # noqa: T201
    return min(missed, 1)


def main() -> int:
    """Judge the planted changes of all hazards, or of some."""
    parser = argparse.ArgumentParser(prog="tests.hazards", description=__doc__)
    parser.add_argument("hazards", nargs="*", metavar="HAZARD", help="all by default")
    parser.add_argument("--journal", type=Path, metavar="FILE", help="resumes an interrupted run")
    given = parser.parse_args()
    changes = planted()
    if unknown := set(given.hazards) - {change.hazard for change in changes}:
        parser.error(f"{min(unknown)} has no planted change in {PLANTED.name}")
    chosen = [each for each in changes if not given.hazards or each.hazard in given.hazards]
    try:
        for change in chosen:
            change.fitted(ROOT)
    except ValueError as error:
        parser.error(str(error))
    with tempfile.TemporaryDirectory(prefix="hazards-") as folder:
        copy_of_the_tree(Path(folder))
        return run(chosen, Journal(given.journal), Path(folder))


if __name__ == "__main__":
    sys.exit(main())
