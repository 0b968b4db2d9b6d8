"""Record of test runs that are too long for CI, with their commit; CI reports outdated ones.

`python -m tools.whole_runs keep NAME` runs the command of a row from a clean tree, shows its
output, and writes docs/runs/NAME.json: command, commit, day, duration, exit code, and the end of
the output. A failed run is recorded as well.

`python -m tools.whole_runs check` reports runs that are missing, failed, or older than the files
under test by more commits than allowed. A row may state until when its failure is tolerated: it is
then only reported. Exit code 0: none; 1: some, or the run failed; 2: the tree has uncommitted
commit has.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from tests.mutations import JUDGES, files_of
from tools.tree import PRODUCTION, ROOT

FOLDER = Path("docs/runs")
MOST_COMMITS = 40  # to the files under test, before a run has to be repeated
KEPT_LINES = 80
OF_MAKE = ("MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES")  # ARGS of the outer make are not the run's
CELL = (*(room for room in PRODUCTION if room != "cli"), "cells")


@dataclass(frozen=True, slots=True)
class WholeRun:
    """Command of a run, and the files under test."""

    command: str
    about: tuple[str, ...]
    may_fail_until: str = ""  # condition until which a failure is tolerated; still reported


RUNS = {
    "chaos-network": WholeRun("make chaos-network ARGS=--write", (*CELL, "tests/chaos")),
    "chaos-clocks": WholeRun("make chaos-clocks", (*CELL, "tests/chaos")),
    "chaos-flood": WholeRun(
        "make chaos-flood", (*CELL, "tests/chaos"), "a cell needs less than one of two processors"
    ),
    "soak": WholeRun("make soak", (*CELL, "tests/chaos")),
    "mutate": WholeRun(
        "make mutate", tuple(dict.fromkeys(name for each in JUDGES for name in files_of(each)))
    ),
}


def git(*words: str, root: Path = ROOT) -> str:
    """Return the output of git. Raises subprocess.CalledProcessError on failure."""
    command = ["git", *words]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def keep(name: str, root: Path = ROOT, run: WholeRun | None = None) -> int:
    """Run a row of the table and record the result; return its exit code."""
    run = run or RUNS[name]
    if git("status", "--porcelain", "--untracked-files=no", root=root):
        print(
            "the tree has uncommitted changes, and a run is recorded for a commit: commit first",
            file=sys.stderr,
        )
        return 2
    commit, began_s = git("rev-parse", "--short=10", "HEAD", root=root), time.monotonic()
    printed: list[str] = []
    with subprocess.Popen(
        run.command.split(),
        cwd=root,
        env={name: value for name, value in os.environ.items() if name not in OF_MAKE},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        for line in process.stdout or ():
            print(line, end="", flush=True)
            printed.append(line.rstrip())
    record = {
        "command": run.command,
        "commit": commit,
        "day": f"{datetime.now(UTC):%Y-%m-%d}",
        "took_s": round(time.monotonic() - began_s),
        "exit_code": process.returncode,
        "printed": printed[-KEPT_LINES:],
    }
    path = root / FOLDER / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return process.returncode


def defect(name: str, root: Path = ROOT, run: WholeRun | None = None) -> str:
    """Return the defect of the recorded run of a row, empty if there is none."""
    run = run or RUNS[name]
    path = root / FOLDER / f"{name}.json"
    again = f"do it again: python -m tools.whole_runs keep {name}"
    if not path.is_file():
        return f"{name}: no run is kept; {again}"
    record = json.loads(path.read_text(encoding="utf-8"))
    if record["command"] != run.command:
        return f"{name}: kept of `{record['command']}`, the table says `{run.command}`; {again}"
    if record["exit_code"] != 0 and not run.may_fail_until:
        return f"{name}: failed at {record['commit']}; fix the cause, and {again}"
    behind = int(
        git("rev-list", "--count", f"{kept_at(name, root)}..HEAD", "--", *run.about, root=root)
    )
    if behind > MOST_COMMITS:
        about = ", ".join(run.about)
        return (
            f"{name}: {behind} commits touched {about} since {record['commit']}, "
            f"{MOST_COMMITS} are allowed; {again}"
        )
    return ""


def kept_at(name: str, root: Path = ROOT) -> str:
    """Return the commit of a recorded run, or the first commit if there is no run.

    If the history was rewritten and lacks it, the commit that added the record.
    """
    path = root / FOLDER / f"{name}.json"
    if not path.is_file():
        return git("rev-list", "--max-parents=0", "HEAD", root=root).split()[0]
    commit: str = json.loads(path.read_text(encoding="utf-8"))["commit"]
    try:
        git("cat-file", "-e", f"{commit}^{{commit}}", root=root)
    except subprocess.CalledProcessError:
        commit = git("log", "-1", "--format=%H", "--", str(path.relative_to(root)), root=root)
    return commit


def main() -> int:
    """Record one run, or check all of them; return the exit code."""
    parser = argparse.ArgumentParser(prog="tools.whole_runs", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("keep").add_argument("name", choices=sorted(RUNS))
    verbs.add_parser("check")
    given = parser.parse_args()
    if given.verb == "keep":
        return min(keep(given.name), 2)
    defects = [found for name in RUNS if (found := defect(name))]
    print("\n".join([*defects, *failures()]) or f"{len(RUNS)} whole runs are kept, all well")
    return 1 if defects else 0


def failures(root: Path = ROOT, runs: Mapping[str, WholeRun] = RUNS) -> Iterator[str]:
    """Yield the recorded runs whose failure is tolerated."""
    for name, run in runs.items():
        path = root / FOLDER / f"{name}.json"
        if run.may_fail_until and path.is_file():
            record = json.loads(path.read_text(encoding="utf-8"))
            if record["exit_code"] != 0:
                yield f"{name}: FAILED at {record['commit']}; it may until {run.may_fail_until}"


if __name__ == "__main__":
    sys.exit(main())
