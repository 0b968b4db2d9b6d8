"""The demo with the adaptive law, in real processes during other work.

Each run is `forcemesh demo --law adaptive --json` as a user starts it. What runs at the same time:
loops without waiting, builds that start processes and read files, and the processes of another
cell. Without real-time priority the right to it is taken away (by util-linux).
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext

from bench.chain.cell import OF_PROCESSES, PRESSING, own_demo, press, running, why_held
from bench.chain.load import busy_loops
from bench.harness import Options, Tables, worst
from bench.results import ROOT, Row
from forcemesh import topics
from launch.processes import Supervisor

RUNS = 20  # of each case
BUSY_LOOPS, BUILDS = 4, 2
WITHIN_S = 180.0  # of one demo: a hold or its own timeouts end it before
READY_S = 60.0
LONG_MINUTES = 10.0
OBSERVE_S = 0.25  # a fourth of the time for which a late step stays in the health
RATES = {"rates.sensor_hz": 500, "rates.control_hz": 250, "rates.robot_hz": 250}
ROOTS_OWN = ("setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")
A_USERS = ("prlimit", "--rtprio=0")


EVERYTHING = f"{BUSY_LOOPS} busy loops, {BUILDS} builds, another cell, not armed; SCHED_FIFO"
CASES = {  # whether there is other work, and the right to priority
    "nothing; SCHED_FIFO": (False, True),
    EVERYTHING: (True, True),
    EVERYTHING.replace("SCHED_FIFO", "ordinary priority"): (True, False),
}


def outcome(printed: str) -> Row | str:
    """Return the result of a demo that settled, or why it did not: without JSON its last line."""
    try:
        found: Row = json.loads(printed)
    except ValueError:
        return (printed.strip().splitlines() or ["no output"])[-1]
    return found if found["settled"] else found.get("error", "the force did not settle")


@contextmanager
def building() -> Iterator[None]:
    """Compile the tree again and again during the block, as a build does."""
    stop = threading.Event()

    def build(folder: str) -> None:
        arguments = [sys.executable, "-X", f"pycache_prefix={folder}", "-m", "compileall", "-qf"]
        for package in itertools.cycle(("common", "sim", "services", "cli", "forcemesh")):
            if stop.is_set():
                return
            command = [*arguments, str(ROOT / package)]
            subprocess.run(command, check=True, start_new_session=True)

    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(BUILDS) as pool:
        builds = [pool.submit(build, folder) for _ in range(BUILDS)]
        try:
            yield
        finally:
            stop.set()
    for each in builds:
        each.result()


@contextmanager
def other_work() -> Iterator[None]:
    """Run loops that never wait, builds and another cell during the block."""
    with Supervisor(own_demo("other")) as supervisor:
        supervisor.wait_ready(READY_S)
        with busy_loops(BUSY_LOOPS), building():
            yield


def play(runs: int, *, busy: bool, realtime: bool) -> list[Row | str]:
    """Run the demo again and again; return the outcomes."""
    words = [sys.executable, "-m", "cli", "demo", "--law", "adaptive", "--json", "--no-panel"]
    if not realtime:
        words = [*(ROOTS_OWN if os.geteuid() == 0 else A_USERS), *words]
    found = []
    with tempfile.TemporaryDirectory() as out, other_work() if busy else nullcontext():
        for _ in range(runs):
            done = subprocess.run(
                [*words, "--out", out],
                capture_output=True, text=True, check=False, cwd=ROOT, timeout=WITHIN_S,
            )  # fmt: skip
            found.append(outcome(done.stdout or done.stderr))
    return found


def measure(options: Options) -> Tables:
    """Run every case, and press during everything else at once."""
    runs = 2 if options.quick else RUNS
    rows = [row(case, runs) for case in CASES]
    press_s = 60.0 * (options.minutes or LONG_MINUTES)
    return {"cases": rows, "long-press": [pressed(press_s)]}


def row(case: str, runs: int) -> Row:
    """Run a case; print it, and why a run did not settle."""
    busy, realtime = CASES[case]
    outcomes = play(runs, busy=busy, realtime=realtime)
    settled = [each for each in outcomes if isinstance(each, dict)]
    failures = [each for each in outcomes if isinstance(each, str)]
    found: Row = {
        "other_work_and_priority": case,
        "runs": runs,
        "settled": len(settled),
        "held": len(failures),
        "largest_overshoot_pct": worst(each["overshoot_pct"] for each in settled),
        "longest_settling_ms": 1e3 * worst(each["settling_s"] for each in settled),
    }
    sys.stderr.write("".join(f"{line}\n" for line in (str(found), *failures)))
    return found


def pressed(duration_s: float) -> Row:
    """Press during everything else at once; return what happened."""
    longest_gap_s, late = 0.0, ""
    with other_work(), running(own_demo("bench-demos", RATES)) as client:
        press(client, "adaptive")
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s and not why_held(client, (PRESSING,)):
            time.sleep(OBSERVE_S)
            for role in OF_PROCESSES:
                health = client.feed(topics.HEALTH[role])()
                if role != "hub":
                    longest_gap_s = max(longest_gap_s, health.longest_gap_s)
                if health.overruns and not late:
                    late = f"{role} was late: {health.late_cause}"
        held = why_held(client, (PRESSING,))
    return {
        "other_work_and_priority": EVERYTHING,
        "minutes": duration_s / 60.0,
        "longest_gap_between_steps_ms": 1e3 * longest_gap_s,
        "late_loop": late,
        "held": held,
        "met": not (held or late),
    }
