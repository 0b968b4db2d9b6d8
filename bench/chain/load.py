"""Processor time and wake-ups of processes, from /proc, and loops that keep the processor busy."""

import multiprocessing
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import thread_time_ns

from sim.robot.arm import SimArm
from sim.robot.engine import mujoco
from sim.robot.settings import SimSettings

TICKS_HZ = os.sysconf("SC_CLK_TCK")
SWITCHES = ("voluntary_ctxt_switches:", "nonvoluntary_ctxt_switches:")
ROUNDS, TICKS = 20, 500
PRESS_N = 20.0
Threads = dict[str, tuple[float, int]]  # name and number: processor time [s], wake-ups


@dataclass(frozen=True, slots=True)
class Load:
    """Processor time and wake-ups of one process in an interval."""

    cpu_pct: float  # of one core
    wakeups_hz: float
    threads_pct: dict[str, float]  # by name


def measured(pids: dict[str, int], work: Callable[[], object]) -> dict[str, Load]:
    """Return the load of processes while this one does something, such as sleep."""
    before, began_s = {name: _threads(pid) for name, pid in pids.items()}, time.monotonic()
    work()
    took_s = time.monotonic() - began_s
    return {name: _load(before[name], _threads(pid), took_s) for name, pid in pids.items()}


def _load(before: Threads, after: Threads, took_s: float) -> Load:
    threads_pct: defaultdict[str, float] = defaultdict(float)
    wakeups = 0
    for thread, (cpu_s, switches) in after.items():
        earlier_s, earlier = before.get(thread, (0.0, 0))
        threads_pct[thread.rpartition(" ")[0]] += 100.0 * (cpu_s - earlier_s) / took_s
        wakeups += switches - earlier
    return Load(sum(threads_pct.values()), wakeups / took_s, threads_pct)


def _threads(pid: int) -> Threads:
    found: Threads = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        name, _, rest = (task / "stat").read_text("utf-8").partition("(")[2].rpartition(")")
        fields = rest.split()
        status = (task / "status").read_text("utf-8").splitlines()
        switches = sum(int(line.split()[1]) for line in status if line.startswith(SWITCHES))
        cpu_s = (int(fields[11]) + int(fields[12])) / TICKS_HZ
        found[f"{name} {task.name}"] = (cpu_s, switches)
    return found


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Run loops without waiting, at normal priority, in sessions of their own during the block.

    Programs that a person starts elsewhere are in other sessions, between which Linux divides the
    processor (sched_autogroup).
    """
    with ExitStack() as exits:
        for _ in range(count):
            exits.enter_context(started(_spin))
        yield


@contextmanager
def started(target: Callable[..., None], *arguments: object) -> Iterator[int]:
    """Run a function in a process of its own during the block; yield its pid."""
    spawn = multiprocessing.get_context("spawn")
    process = spawn.Process(target=target, args=arguments, daemon=True)
    process.start()
    try:
        yield process.pid or 0
    finally:
        process.kill()
        process.join()


def _spin() -> None:
    os.setsid()
    parent = os.getppid()
    while os.getppid() == parent:  # a bench that was killed leaves no loops
        for _ in range(1_000_000):
            pass


def engine_us() -> float:
    """Return the time of MuJoCo's own steps in a tick of a pressing arm, in the best round [us]."""
    arm = SimArm(SimSettings(delay_s=0.0), seed=0)
    settings, T = arm.settings, arm.T_base_flange
    T.translation[2] -= settings.gap_m + PRESS_N / settings.stiffness_N_m
    found = arm.kinematics.solve(T, arm.q, jump_rad=1.0)
    if found.q is None:
        raise ValueError(found.reason)
    arm.command_joints(found.q)
    for _ in range(TICKS):
        arm.step()
    rounds_us = []
    for _ in range(ROUNDS):
        start_ns = thread_time_ns()
        for _ in range(TICKS):
            mujoco.mj_step1(arm.model, arm.data)
            mujoco.mj_step2(arm.model, arm.data)
        rounds_us.append((thread_time_ns() - start_ns) / TICKS / 1e3)
    return min(rounds_us)
