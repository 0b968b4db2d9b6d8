"""The demo with the adaptive law, in real processes during other work: `python -m bench demos`.

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
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from rich.table import Table

from bench.chain.cell import PRESSING, press, why_held
from bench.chain.load import busy_loops
from bench.tables import as_markdown, on_screen
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import Health
from launch.processes import Supervisor
from tests.chaos.common_net import free_port
from tools.figures import replace_block

ROOT = Path(__file__).resolve().parent.parent
DEMO = ROOT / "cells" / "demo.yaml"
RUNS = 20  # of each case
BUSY_LOOPS, BUILDS = 4, 2
WITHIN_S = 180.0  # of one demo: a hold or its own timeouts end it before
READY_S = 60.0
LONG_S = 600.0
OBSERVE_S = 0.25  # a fourth of the time for which a late step stays in the health
RATES = {"rates.sensor_hz": 500, "rates.control_hz": 250, "rates.robot_hz": 250}
# The simulated robot's process is the sensor as well.
OF_PROCESSES = tuple(role for role in topics.ROLES if role != "sensor")
ROOTS_OWN = ("setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")
A_USERS = ("prlimit", "--rtprio=0")


@dataclass(frozen=True, slots=True)
class DemoCase:
    """What runs at the same time as the demo, and with which priority the demo runs."""

    loops: bool = False
    builds: bool = False
    cell: bool = False
    realtime: bool = True

    def __str__(self) -> str:
        """Return the case in words."""
        names = {
            f"{BUSY_LOOPS} busy loops": self.loops,
            f"{BUILDS} builds": self.builds,
            "another cell, not armed": self.cell,
        }
        others = ", ".join(name for name, is_there in names.items() if is_there) or "nothing"
        return f"{others}; {'SCHED_FIFO' if self.realtime else 'ordinary priority'}"


CASES = [
    DemoCase(),
    DemoCase(loops=True, builds=True, cell=True),
    DemoCase(loops=True, builds=True, cell=True, realtime=False),
]


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
    late: str = ""  # the first loop that was late, or why the arm held

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
def other_work(case: DemoCase) -> Iterator[None]:
    """Run a case's other work during the block."""
    with ExitStack() as exits:
        if case.cell:
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            other = load_cell(DEMO, {"cell": "other", "bus.endpoint": endpoint})
            exits.enter_context(Supervisor(other)).wait_ready(READY_S)
        exits.enter_context(busy_loops(BUSY_LOOPS if case.loops else 0))
        if case.builds:
            exits.enter_context(building())
        yield


def play(case: DemoCase, runs: int = RUNS) -> DemoResults:
    """Run the demo in a case, again and again."""
    words = [sys.executable, "-m", "cli", "demo", "--law", "adaptive", "--json", "--no-panel"]
    if not case.realtime:
        words = [*(ROOTS_OWN if os.geteuid() == 0 else A_USERS), *words]
    found = DemoResults()
    with tempfile.TemporaryDirectory() as out, other_work(case):
        for _ in range(runs):
            done = subprocess.run(
                [*words, "--out", out],
                capture_output=True, text=True, check=False, cwd=ROOT, timeout=WITHIN_S,
            )  # fmt: skip
            found.add(done.stdout or done.stderr)
    return found


HEAD = ["other work; priority", "runs", "settled", "held", "largest overshoot", "longest settling"]


def rows(runs: int = RUNS) -> list[list[str]]:
    """Run every case; return a row for each, print it, and why a run did not settle."""
    found = []
    for case in CASES:
        results = play(case, runs)
        row = [
            str(case),
            str(runs),
            str(results.settled),
            str(len(results.failures)),
            f"{max(results.overshoot_pct, default=0.0):.1f} %",
            f"{1e3 * max(results.settling_s, default=0.0):.0f} ms",
        ]
        sys.stderr.write("".join(f"{line}\n" for line in (" | ".join(row), *results.failures)))
        found.append(row)
    return found


def pressed_throughout() -> str:
    """Press for ten minutes during everything else at once; return what happened in a sentence."""
    case = next(each for each in CASES if each.loops and each.builds and each.cell)
    changes = {"cell": "bench-demos", "bus.endpoint": f"tcp/127.0.0.1:{free_port()}", **RATES}
    cell, found = load_cell(DEMO, changes), LongPress()
    with other_work(case), Supervisor(cell) as supervisor:
        supervisor.wait_ready(WITHIN_S)
        with ConfiguredCell(cell, commander="operator") as client:
            client.wait_ready(WITHIN_S)
            press(client, "adaptive")
            _observe(client, found)
    return (
        f"Pressing for {LONG_S / 60.0:g} minutes during {case}: "
        f"{found.late or 'no hold and no late loop'}; "
        f"longest gap between two steps {1e3 * found.longest_gap_s:.0f} ms."
    )


def _observe(client: ConfiguredCell, found: LongPress) -> None:
    """Note late loops until the end of the press, or until the arm holds."""
    end_s = time.monotonic() + LONG_S
    while time.monotonic() < end_s:
        time.sleep(OBSERVE_S)
        for role in OF_PROCESSES:
            found.note(role, client.feed(topics.HEALTH[role])())
        if held := why_held(client, (PRESSING,)):
            found.late = f"the arm held: {held}"
            return


def table() -> Table:
    """Run, and return the table for the terminal."""
    return on_screen("demos with the adaptive law during other work", HEAD, rows())


def write() -> None:
    """Run, and write the table and the long press into docs/realtime.md."""
    text = f"{as_markdown(HEAD, rows())}\n\n{pressed_throughout()}"
    replace_block(ROOT / "docs" / "realtime.md", "demos", text, 'make bench ARGS="demos --write"')
