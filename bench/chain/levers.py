"""Comparison of the cell before and after its levers, and of its variants, in turn in one run."""

import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from statistics import median
from typing import Any

import numpy as np

from bench.chain import bare, cell
from bench.results import ROOT, Row
from common.motion.frames import Array
from forcemesh.messages import Law

BEFORE = "7f9c5778"  # the last commit before these levers
RATES = {"rates.sensor_hz": 500, "rates.control_hz": 250}
ADAPTIVE: Law = "adaptive"
BARE = bare.CHAINS["zenoh"]
LEVERS: dict[str, tuple[dict[str, Any], Law | None]] = {  # changes of the cell file, law
    "as it is: fewer wake-ups": ({}, ADAPTIVE),
    "wrench, regulator together": ({"together": ["wrench", "regulator"]}, ADAPTIVE),
    "wrench, regulator, arbiter together": (
        {"together": ["wrench", "regulator", "arbiter"]},
        ADAPTIVE,
    ),
    "as it is, armed and idle": ({}, None),
}
WITHIN_S = 600.0
# Executed in the tree of another revision, which has its own bench and services.
IN_ANOTHER_TREE = """
import json, sys
from bench.chain import cell
changes, duration_s = json.loads(sys.argv[1]), float(sys.argv[2])
run = cell.run(cell.own_demo("bench-before", changes), duration_s, law="adaptive", realtime=True)
pct = sum(each.cpu_pct for each in run.load.values())
print(json.dumps([pct, run.chain_us.tolist(), run.held]))
"""

QUANTITIES = ("processor_core_pct", "p50_us", "p99_us")
RATIOS = ("cpu_ratio", "p50_ratio", "p99_ratio")
Measured = tuple[float, ...]  # the quantities


def rows(rounds: int, duration_s: float) -> Iterator[Row]:
    """Yield medians of each lever, relative to the bare chain of the same run.

    Rounds in which the arm held have no numbers; they are counted.
    """
    held = defaultdict[str, int](int)
    found: defaultdict[str, list[Measured]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        _git("worktree", "add", "--detach", folder, BEFORE)
        try:
            for _ in range(rounds):
                for name, (pct, times_us, why) in _round(folder, duration_s):
                    held[name] += bool(why)
                    if not why:
                        found[name].append((pct, *np.percentile(times_us, [50, 99])))
        finally:
            _git("worktree", "remove", "--force", folder)
    medians = {name: tuple(map(median, zip(*each, strict=True))) for name, each in found.items()}
    for name, count in held.items():
        values = medians.get(name, (None,) * len(QUANTITIES))
        ratios = [
            None if value is None else value / plain
            for value, plain in zip(values, medians[BARE], strict=True)
        ]
        row = dict(zip((*QUANTITIES, *RATIOS), (*values, *ratios), strict=True))
        yield {"cell": name, **row, "rounds_held": count}


def _round(folder: str, duration_s: float) -> Iterator[tuple[str, tuple[float, Array, str]]]:
    """Yield processor time, times and why the arm held of each lever, and of the bare chain."""
    words = [sys.executable, "-c", IN_ANOTHER_TREE, json.dumps(RATES), str(duration_s)]
    done = subprocess.run(
        words, cwd=folder, stdout=subprocess.PIPE, text=True, check=True, timeout=WITHIN_S
    )
    pct, times_us, held = json.loads(done.stdout.splitlines()[-1])
    yield f"before, at {BEFORE}", (pct, np.array(times_us), held)
    for name, (changes, law) in LEVERS.items():
        own = cell.own_demo("bench-levers", {**RATES, **changes})
        run = cell.run(own, duration_s, law=law, realtime=True)
        pct = sum(each.cpu_pct for each in run.load.values())
        yield name, (pct, run.chain_us, run.held)
    plain = cell.own_demo("bench-levers", RATES)
    times_us, load = bare.run("zenoh", plain, RATES["rates.control_hz"], duration_s, realtime=True)
    yield BARE, (sum(each.cpu_pct for each in load.values()), times_us, "")


def _git(*words: str) -> None:
    command = ["git", *words]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
