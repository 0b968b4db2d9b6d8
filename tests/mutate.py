"""Mutation test of the modules that decide about motion: changes that no test detects.

`python -m tests.mutate [MODULE ...] [--count N] [--seed S] [--since REF]`.

No file is changed: a forked process imports the changed text in the module's place and runs the
module's tests. Processes that tests start import the unchanged module, so tests of real processes
are left out. A survivor that is listed in `tests/survivors.txt` with its reason is accepted; a
listed one that is killed is reported as well. The program of the controller has
`tests.mutate_program`.

Exit code 0: no survivor that is not listed; 1: some; 2: wrong arguments, or the tests fail without
a mutant.
"""

import argparse
import importlib.abc
import importlib.util
import multiprocessing
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

from tests.mutations import JUDGES, ROOT, Mutant, files_of, judges_of, mutants_of, path_of

SURVIVORS = ROOT / "tests" / "survivors.txt"
LEAST_S, TIMES_LONGER = 60.0, 6.0  # a run that is longer than both is in an endless loop: killed


# --- running the tests of one --------------------------------------------------------------------


class Instead(importlib.abc.MetaPathFinder):
    """Import finder that loads one module from another text."""

    def __init__(self, mutant: Mutant) -> None:
        """Store the module and its text."""
        self._mutant = mutant

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the origin of the changed module, None for others."""
        if fullname != self._mutant.module:
            return None
        loader = ChangedText(fullname, str(path_of(fullname)), self._mutant.text)
        return importlib.util.spec_from_file_location(fullname, loader.path, loader=loader)


class ChangedText(SourceFileLoader):
    """Loader that compiles a text instead of the file."""

    def __init__(self, fullname: str, path: str, text: str) -> None:
        """Store the text."""
        super().__init__(fullname, path)
        self._text = text

    def get_code(self, _fullname: str) -> CodeType:
        """Return the code; no cache is read or written."""
        return compile(self._text, self.path, "exec", dont_inherit=True)


def is_killed(mutant: Mutant) -> bool:
    """Run a module's tests on a mutant, in this process; return whether one of them fails."""
    os.environ["CI"] = "1"  # the same examples every time
    sys.meta_path.insert(0, Instead(mutant))
    sys.stdout = sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    os.dup2(sys.stdout.fileno(), 1)
    os.dup2(sys.stdout.fileno(), 2)
    import pytest  # noqa: PLC0415 - after the finder is in place: it imports what is under test

    files = [str(ROOT / name) for name in judges_of(mutant.module)]
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", "-p", "no:xdist"]
    chosen = ["-m", "not (realtime or processes or long)", "--hypothesis-profile", "mutants"]
    try:
        return pytest.main([*options, *chosen, *files]) != pytest.ExitCode.OK
    except BaseException:  # noqa: BLE001 - any error is a detection
        return True


def forked(mutant: Mutant, within_s: float) -> tuple[bool, float]:
    """Judge a mutant in a process of its own; return whether it is killed, and the duration."""
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
    """Return the reviewed survivors, each with its reason."""
    rows = [row for row in path.read_text(encoding="utf-8").splitlines() if row.strip()]
    pairs = [row.split(" | ", 1) for row in rows if not row.startswith("#")]
    lacking = [pair[0] for pair in pairs if len(pair) == 1 or not pair[1].strip()]
    if lacking:
        raise ValueError(f"{path.name}: no reason after ' | ' for {lacking[0]}")
    return {title.strip(): reason.strip() for title, reason in pairs}


def changed_since(reference: str) -> list[str]:
    """Return the modules of the table whose files or tests a range of commits changes."""
    command = ["git", "diff", "--name-only", reference, "--"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    touched = set(done.stdout.splitlines())
    return [module for module in JUDGES if touched.intersection(files_of(module))]


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


def limits_s(modules: Sequence[str]) -> dict[str, float]:
    """Return the time limit of each module's tests; exit where they fail without a mutant."""
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
    results: Iterator[tuple[Mutant, bool]],
    known: dict[str, str],
    print_line: Callable[[str], object],
) -> int:
    """Print the verdict of each; return the number of survivors that are not listed."""
    killed = survivors = 0
    for mutant, was_killed in results:
        killed += was_killed
        if was_killed and mutant.title in known:
            print_line(f"killed, and listed as a survivor: {mutant.title}")
        elif not was_killed and mutant.title not in known:
            survivors += 1
            print_line(f"SURVIVED {mutant.title}")
    print_line(f"{killed} killed, {survivors} survived that are not listed")
    return survivors


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
        survivors = report(pool.imap(judge, pairs), known, lambda line: print(line, flush=True))  # noqa: T201
    return min(survivors, 1)


def preload() -> None:
    """Import large packages of others before the fork, except plugins, which pytest imports."""
    for name in ("lark", "mujoco", "msgpack", "msgspec", "pinocchio", "pydantic", "zenoh"):
        importlib.import_module(name)


if __name__ == "__main__":
    preload()
    sys.exit(main())
