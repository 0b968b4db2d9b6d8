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
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from math import inf

from bench.chain.cell import PRESSING, press, why_held
from bench.chain.load import busy_loops
from bench.harness import Options
from bench.results import ROOT, Row, Table, table
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import Health
from launch.processes import Supervisor
from tests.chaos.common_net import free_port

DEMO = ROOT / "cells" / "demo.yaml"
RUNS = 20  # of each case
BUSY_LOOPS, BUILDS = 4, 2
WITHIN_S = 180.0  # of one demo: a hold or its own timeouts end it before
READY_S = 60.0
LONG_MINUTES = 10.0
OBSERVE_S = 0.25  # a fourth of the time for which a late step stays in the health
RATES = {"rates.sensor_hz": 500, "rates.control_hz": 250, "rates.robot_hz": 250}
# The simulated robot's process is the sensor as well.
OF_PROCESSES = tuple(role for role in topics.ROLES if role != "sensor")
COLUMNS = {
    "other_work_and_priority": "", "runs": "d", "settled": "d", "held": "d",
    "largest_overshoot_pct": ".1f", "longest_settling_ms": ".0f",
}  # fmt: skip
PRESSED = {
    "other_work_and_priority": "", "minutes": "g", "longest_gap_between_steps_ms": ".0f",
    "late_loop": "", "held": "", "met": "",
}  # fmt: skip
ROOTS_OWN = ("setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")
A_USERS = ("prlimit", "--rtprio=0")


@dataclass(frozen=True, slots=True)
class DemoCase:
    """Whether there is other work at the same time, and the priority of the demo."""

    busy: bool = False
    realtime: bool = True

    def __str__(self) -> str:
        """Return the case in words."""
        busy = f"{BUSY_LOOPS} busy loops, {BUILDS} builds, another cell, not armed"
        priority = "SCHED_FIFO" if self.realtime else "ordinary priority"
        return f"{busy if self.busy else 'nothing'}; {priority}"


CASES = [DemoCase(), DemoCase(busy=True), DemoCase(busy=True, realtime=False)]


@dataclass(slots=True)
class DemoResults:
    """Results of the runs of a case."""

    settled: int = 0
    overshoot_pct: list[float] = field(default_factory=list)  # of those that settled
    settling_s: list[float] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)  # why the others ended

    def add(self, printed: str) -> None:
        """Add the output of a demo; one without JSON is a failure with its last line."""
        try:
            found = json.loads(printed)
        except ValueError:
            self.failures.append((printed.strip().splitlines() or ["no output"])[-1])
            return
        if not found["settled"]:
            self.failures.append(found.get("error", "the force did not settle"))
            return
        self.settled += 1
        self.overshoot_pct.append(found["overshoot_pct"])
        self.settling_s.append(found["settling_s"])


@dataclass(slots=True)
class LongPress:
    """What a long press has shown."""

    longest_gap_s: float = 0.0  # between two steps of any loop but the hub's
    late: str = ""  # the first loop that was late

    def note(self, role: str, health: Health) -> None:
        """Note the longest gap of a loop, and the first overrun."""
        if role != "hub":
            self.longest_gap_s = max(self.longest_gap_s, health.longest_gap_s)
        if health.overruns and not self.late:
            self.late = f"{role} was late: {health.late_cause}"


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

    with tempfile.TemporaryDirectory() as folder:
        threads = [threading.Thread(target=build, args=(folder,)) for _ in range(BUILDS)]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            stop.set()
            for thread in threads:
                thread.join()


@contextmanager
def other_work() -> Iterator[None]:
    """Run loops that never wait, builds and another cell during the block."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    other = load_cell(DEMO, {"cell": "other", "bus.endpoint": endpoint})
    with Supervisor(other) as supervisor:
        supervisor.wait_ready(READY_S)
        with busy_loops(BUSY_LOOPS), building():
            yield


def play(case: DemoCase, runs: int = RUNS) -> DemoResults:
    """Run the demo in a case, again and again."""
    words = [sys.executable, "-m", "cli", "demo", "--law", "adaptive", "--json", "--no-panel"]
    if not case.realtime:
        words = [*(ROOTS_OWN if os.geteuid() == 0 else A_USERS), *words]
    found = DemoResults()
    busy = other_work() if case.busy else nullcontext()
    with tempfile.TemporaryDirectory() as out, busy:
        for _ in range(runs):
            done = subprocess.run(
                [*words, "--out", out],
                capture_output=True, text=True, check=False, cwd=ROOT, timeout=WITHIN_S,
            )  # fmt: skip
            found.add(done.stdout or done.stderr)
    return found


def measure(options: Options) -> dict[str, Table]:
    """Run every case, and press during everything else at once."""
    runs = 2 if options.quick else RUNS
    rows = [row(case, runs) for case in CASES]
    press_s = 60.0 * (options.minutes or LONG_MINUTES)
    return {"cases": table(COLUMNS, rows), "long-press": table(PRESSED, [pressed(press_s)])}


def row(case: DemoCase, runs: int) -> Row:
    """Run a case; print it, and why a run did not settle."""
    results = play(case, runs)
    found: Row = {
        "other_work_and_priority": str(case),
        "runs": runs,
        "settled": results.settled,
        "held": len(results.failures),
        "largest_overshoot_pct": max(results.overshoot_pct, default=None),
        "longest_settling_ms": 1e3 * max(results.settling_s, default=inf),
    }
    sys.stderr.write("".join(f"{line}\n" for line in (str(found), *results.failures)))
    return found


def pressed(duration_s: float) -> Row:
    """Press during everything else at once; return what happened."""
    changes = {"cell": "bench-demos", "bus.endpoint": f"tcp/127.0.0.1:{free_port()}", **RATES}
    cell, found = load_cell(DEMO, changes), LongPress()
    with other_work(), Supervisor(cell) as supervisor:
        supervisor.wait_ready(WITHIN_S)
        with ConfiguredCell(cell, commander="operator") as client:
            client.wait_ready(WITHIN_S)
            press(client, "adaptive")
            end_s = time.monotonic() + duration_s
            while time.monotonic() < end_s and not why_held(client, (PRESSING,)):
                time.sleep(OBSERVE_S)
                for role in OF_PROCESSES:
                    found.note(role, client.feed(topics.HEALTH[role])())
            held = why_held(client, (PRESSING,))
    return {
        "other_work_and_priority": str(DemoCase(busy=True)),
        "minutes": duration_s / 60.0,
        "longest_gap_between_steps_ms": 1e3 * found.longest_gap_s,
        "late_loop": found.late,
        "held": held,
        "met": not (held or found.late),
    }
