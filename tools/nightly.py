"""Nightly runs: parts that do not judge one change and are too long for `.ci/run`.

`make nightly` runs all parts, `make nightly ARGS="chaos soak"` these; `ARGS=--list` shows them with
their expected duration. The result of each part is written to a journal of this commit,
`out/nightly/<commit>.jsonl`: an interrupted run continues with the first part that has no result,
and a part that failed is not repeated on the same commit.

Exit code 0: all requested parts passed; 1: some failed; 2: wrong arguments, or the tree has
uncommitted changes.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from tools.tree import ROOT

MOST_S = 90 * 60  # of one part
LAST_LINES = 20  # of the output, in the journal
OF_MAKE = ("MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES")  # ARGS of the outer make are not the part's
PYTEST = "python -m pytest -q -o timeout=600"


@dataclass(frozen=True, slots=True)
class Part:
    """Command, expected duration on two cores, and additional environment."""

    command: str
    minutes: float
    environment: Mapping[str, str] | None = None


PARTS = {
    "long": Part("tools/test.sh", 25, {"LONG": "1", "CI": "1"}),
    "browser": Part(f"{PYTEST} -m browser tests/browser", 5),
    "bring-up": Part(f"{PYTEST} -m ladder tests/scenario/test_bringup_processes.py", 6),
    "axes": Part(f"{PYTEST} -n auto -m axes tests/scenario/test_force_axes.py", 15),
    "mutate": Part("python -m tests.mutate --count 8", 60),
    "mutate-program": Part("python -m tests.mutate --program --count 24", 30),
    "hazards": Part("python -m tests.hazards --journal out/nightly/hazards.jsonl", 20),
    "chaos-sim": Part("python -m tests.chaos --cell sim --each 10", 32),
    "chaos-tcp": Part("python -m tests.chaos --cell tcp --each 10", 45),
    "chaos-network": Part("python -m tests.chaos.network", 6),
    "chaos-flood": Part("python -m tests.chaos.flood", 2),
    "chaos-clocks": Part("python -m tests.chaos.clocks", 1),
    "soak": Part("python -m tests.chaos.soak", 11),
    "soak-sensor": Part("python -m bench sensor-soak", 11),
    "hostile": Part("python -m tests.hostile", 10),
    "chain": Part("python -m bench chain --quick", 5),
    "flips": Part(
        f"{PYTEST} -n auto -m long tests/contract/test_abuse_reports.py", 25, {"EVERY_FLIP": "1"}
    ),
    "subscribers": Part(f"{PYTEST} -m cargo tests/contract/test_subscribers.py", 5, {"CI": "1"}),
    "fuzz": Part("python -m tests.fuzz --seconds 60", 10),
    "fuzz-commands": Part("python -m tests.fuzz.commands", 20),
}


@dataclass(frozen=True, slots=True)
class Result:
    """One line of the journal."""

    part: str
    exit_code: int
    took_s: float
    printed: Sequence[str] = ()


def run(name: str, part: Part, most_s: float = MOST_S) -> Result:
    """Run a part, show its output, and return its result; after `most_s` it is ended."""
    began_s, printed = time.monotonic(), list[str]()
    words = [sys.executable if word == "python" else word for word in part.command.split()]
    command = ["timeout", "--kill-after=60", f"{most_s}", *words]
    environment = {key: value for key, value in os.environ.items() if key not in OF_MAKE}
    with subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment | dict(part.environment or {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            for line in process.stdout or ():
                print(line, end="", flush=True)
                printed = [*printed[1 - LAST_LINES :], line.rstrip()]
        except BaseException:
            os.killpg(process.pid, signal.SIGTERM)
            raise
    return Result(name, process.returncode, round(time.monotonic() - began_s, 1), printed)


def read(journal: Path) -> dict[str, Result]:
    """Return the results of a journal by part."""
    lines = journal.read_text(encoding="utf-8").splitlines() if journal.is_file() else []
    results = [Result(**json.loads(line)) for line in lines]
    return {result.part: result for result in results}


def run_all(names: Sequence[str], journal: Path, parts: Mapping[str, Part] = PARTS) -> int:
    """Run the parts without a result in the journal; return the number of those that failed."""
    results = read(journal)
    left = [name for name in names if name not in results]
    minutes = sum(parts[name].minutes for name in left)
    print(
        f"{len(left)} of {len(names)} parts to run, about {minutes:.0f} minutes: {' '.join(left)}"
    )
    for name in left:
        print(f"--- {name}, about {parts[name].minutes:g} minutes", flush=True)
        result = results[name] = run(name, parts[name])
        journal.parent.mkdir(parents=True, exist_ok=True)
        with journal.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(result)) + "\n")
    print(f"\nresults in {journal}:")
    for name in names:
        verdict = (
            "passed" if results[name].exit_code == 0 else f"FAILED ({results[name].exit_code})"
        )
        print(f"{name:16} {verdict:14} {results[name].took_s / 60:5.1f} min")
    return sum(results[name].exit_code != 0 for name in names)


def parts_of(word: str) -> list[str]:
    """Return the part of a name, or the parts whose names begin with a word."""
    return [name for name in PARTS if word in (name, name.split("-")[0])]


def git(*words: str) -> str:
    """Return the output of git in this tree."""
    command = ["git", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def main() -> int:
    """Run the requested parts; return the exit code."""
    parser = argparse.ArgumentParser(prog="make nightly ARGS=...", description=__doc__)
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"of {' '.join(PARTS)}; chaos: all of chaos-*"
    )
    parser.add_argument("--list", action="store_true", help="list the parts, run nothing")
    given = parser.parse_args()
    if given.list:
        for name, part in PARTS.items():
            print(f"{name:16} {part.minutes:4.0f} min  {part.command}")
        return 0
    if unknown := [word for word in given.parts if not parts_of(word)]:
        parser.error(f"no part {', '.join(unknown)}; there are {' '.join(PARTS)}")
    requested = {name for word in given.parts for name in parts_of(word)}
    names = [name for name in PARTS if not requested or name in requested]
    if git("status", "--porcelain", "--untracked-files=no"):
        parser.error(
            "the tree has uncommitted changes, and results belong to a commit: commit first"
        )
    journal = ROOT / "out" / "nightly" / f"{git('rev-parse', '--short=10', 'HEAD')}.jsonl"
    return min(1, run_all(names, journal))


if __name__ == "__main__":
    sys.exit(main())
