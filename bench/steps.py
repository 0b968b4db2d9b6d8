"""Cost of one step of each service while the arm presses: `python -m bench steps instructions`.

All services run in turn in one process on a virtual clock, and a loop of plain arithmetic is timed
among them: steps in loops can be compared between machines and days. Times are processor time of
the thread, so other processes disturb only the caches. Nothing disturbs the number of
instructions, which needs valgrind and minutes.
"""

import os
import re
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import process_time, thread_time_ns
from typing import Any

from rich.table import Table

from bench.tables import on_screen
from forcemesh.messages import Law
from sim.robot.engine import mujoco
from tools.walks import pressing

ROOT = Path(__file__).resolve().parent.parent
TIMED_S, COUNTED_S = 4.0, 0.2  # virtual time
LEAST_PACE = 4.0
LOOP = range(1000)
PHYSICS = ("mj_step1", "mj_step2")  # MuJoCo's part of the simulated robot's step
COUNTED = re.compile(r"Collected : (\d+)")


@dataclass(frozen=True)
class Part:
    """A service whose step is measured."""

    budget_us: float
    role: str
    cell: str = "demo.yaml"
    law: Law = "plain"


PARTS = {
    "wrench": Part(120.0, "wrench"),
    "regulator, plain law": Part(200.0, "regulator"),
    "regulator, adaptive law": Part(250.0, "regulator", law="adaptive"),
    "arbiter": Part(250.0, "arbiter"),
    "simulated robot, without MuJoCo": Part(130.0, "robot"),
    "gateway": Part(250.0, "robot", "demo-tcp.yaml"),
}

Call = Callable[..., Any]


@contextmanager
def through(call: Call, owner: Any, *names: str) -> Iterator[None]:
    """Let `call(function, *arguments)` make every call of these functions of an owner."""
    functions = {name: getattr(owner, name) for name in names}
    for name, function in functions.items():
        setattr(owner, name, lambda *given, function=function: call(function, *given))
    try:
        yield
    finally:
        for name, function in functions.items():
            setattr(owner, name, function)


# --- time -----------------------------------------------------------------------------------------


def table() -> Table:
    """Return a row for each part: its budget and its times."""
    rows = []
    for name, part in PARTS.items():
        steps_us, loops_us = times_us(part)
        median_us, loop_us = statistics.median(steps_us), statistics.median(loops_us)
        times = (part.budget_us, median_us, min(steps_us))
        in_loops = f"{median_us / loop_us:.1f}"
        rows.append([name, *(f"{time_us:.0f}" for time_us in times), in_loops])
    head = ("part", "budget", "median", "lowest", "in loops")
    return on_screen("a step while the arm presses, CPU time in us", head, rows)


@dataclass
class Stopwatch:
    """Processor time of the calls that go through it [us]."""

    times_us: list[float] = field(default_factory=list)

    def call(self, function: Call, *arguments: Any) -> None:
        """Call a function and keep its time."""
        start_ns = thread_time_ns()
        function(*arguments)
        self.times_us.append((thread_time_ns() - start_ns) / 1e3)


def times_us(part: Part) -> tuple[list[float], list[float]]:
    """Return the times of all steps of a part, and of the loop after each of them [us]."""
    cell, steps, loops, physics = (
        pressing(part.cell, part.law),
        Stopwatch(),
        Stopwatch(),
        Stopwatch(),
    )

    def timed(step: Call, now_ns: int) -> None:
        physics.times_us.clear()
        steps.call(step, now_ns)
        steps.times_us[-1] -= sum(physics.times_us)
        loops.call(_loop)

    service = cell.runners[part.role].service
    with through(physics.call, mujoco, *PHYSICS), through(timed, service, "step"):
        cell.advance(TIMED_S)
    return steps.times_us, loops.times_us


def virtual_table() -> Table:
    """Return how much faster than real time a virtual cell runs that presses, on one core."""
    rows = []
    for file, law in (
        ("demo.yaml", "plain"),
        ("demo.yaml", "adaptive"),
        ("demo-tcp.yaml", "plain"),
    ):
        cell = pressing(file, law)
        began_s = process_time()
        cell.advance(TIMED_S)
        rows.append([f"{file}, {law} law", f"{TIMED_S / (process_time() - began_s):.1f}"])
    title = f"a virtual cell that presses, on one core: at least {LEAST_PACE:g} times real time"
    return on_screen(title, ("cell", "times real time"), rows)


def _loop() -> None:
    total = 0.0
    for number in LOOP:
        total += 0.5 * number


# --- instructions ---------------------------------------------------------------------------------


def instructions_table() -> Table:
    """Return a row for each part: its instructions."""
    rows = []
    for name, part in PARTS.items():
        counted = _instructions(name)
        if (part.role, part.cell) == ("robot", "demo.yaml"):
            counted -= _instructions(name, *PHYSICS)
        rows.append([name, f"{counted / 1e3:.0f}"])
    title = "a step while the arm presses, thousand instructions"
    return on_screen(title, ("part", "instructions"), rows)


def _instructions(*words: str) -> int:
    """Return the instructions of a step that `count` lets callgrind count."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        sys.exit(
            "instructions are counted by valgrind, which is not installed: apt install valgrind"
        )
    done = subprocess.run(
        [
            valgrind, "--tool=callgrind", "--callgrind-out-file=/dev/null",
            "--toggle-collect=_PyEval_CallTracing", sys.executable, "-m", "bench.steps", *words,
        ],
        cwd=ROOT,
        env={**os.environ, "PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )  # fmt: skip
    (collected,) = COUNTED.findall(done.stderr)
    return int(collected) // int(done.stdout)


def count(name: str, *physics: str) -> int:
    """Let the steps of a part, or only MuJoCo's functions in them, be counted; return their number.

    `sys.call_tracing` calls a function as usual; callgrind counts while it runs, and nothing else
    uses it.
    """
    part, steps = PARTS[name], 0

    def counted(function: Call, *arguments: Any) -> None:
        sys.call_tracing(function, arguments)

    def stepped(step: Call, now_ns: int) -> None:
        nonlocal steps
        steps += 1
        if physics:
            step(now_ns)
        else:
            counted(step, now_ns)

    cell = pressing(part.cell, part.law)
    service = cell.runners[part.role].service
    with through(counted, mujoco, *physics), through(stepped, service, "step"):
        cell.advance(COUNTED_S)
    return steps


if __name__ == "__main__":
    print(count(*sys.argv[1:]))
