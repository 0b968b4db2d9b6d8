"""Processor time of one step of each service while the arm presses.

All services run in turn in one process on a virtual clock, and a loop of plain arithmetic is timed
among them: steps in loops can be compared between machines and days. Times are processor time of
the thread, so other processes disturb only the caches.
"""

import statistics
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import thread_time_ns
from typing import Any

from bench.tables import as_markdown
from forcemesh.messages import Law
from sim.robot.engine import mujoco
from tools.walks import pressing

TIMED_S = 4.0  # virtual time
LOOP = range(1000)
PHYSICS = ("mj_step1", "mj_step2")  # MuJoCo's part of the simulated robot's step


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


def steps_table() -> str:
    """Return a row for each part as Markdown: its budget and its times."""
    rows = []
    for name, part in PARTS.items():
        steps_us, loops_us = times_us(part)
        median_us, loop_us = statistics.median(steps_us), statistics.median(loops_us)
        times = (part.budget_us, median_us, min(steps_us))
        in_loops = f"{median_us / loop_us:.1f}"
        rows.append([name, *(f"{time_us:.0f}" for time_us in times), in_loops])
    return as_markdown(("part", "budget us", "median us", "lowest us", "in loops"), rows)


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


def _loop() -> None:
    total = 0.0
    for number in LOOP:
        total += 0.5 * number
