"""Wake-up latency of each core of this PC, as cyclictest measures it.

One process for each core, bound to it and with the priority of the services where that is granted,
sleeps to the next millisecond, again and again. How late it wakes is how late a control loop does.
"""

import gc
import multiprocessing as mp
import os
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Literal

import numpy as np

from cli.doctor.checks import ReportLine, finding, passed
from common.config.cell import CellConfig
from common.runtime.realtime import (
    PRIORITY,
    has_realtime_priority,
    lock_memory,
    take_realtime_priority,
    waited_ns,
)
from forcemesh.clock import NS_PER_S

PERIOD_NS = 1_000_000
WAITED_SHARE = 0.5  # of the longest latency: beyond, other work on the core is its cause

LatencyCause = Literal["other work", "the core"]
CAUSES: dict[LatencyCause, str] = {
    "other work": "the longest one waited for other work on this core",
    "the core": "in the longest one the core itself did not run: power saving, an interrupt, "
    "or the host of a virtual machine",
}


@dataclass(frozen=True, slots=True)
class CoreLatency:
    """How late one core woke a process."""

    core: int
    late_s: tuple[float, ...]  # of each wake-up
    is_realtime: bool  # had the priority of the services
    cause: LatencyCause  # of the longest one


def latency_lines(cell: CellConfig, duration_s: float) -> list[ReportLine]:
    """Measure every core that this process may use; return a line for each."""
    longest_s = min(cell.deadlines.command_s, cell.deadlines.sensor_s)
    period_s = 1.0 / cell.rates.control_hz
    return [
        check_latency(found, period_s=period_s, deadline_s=longest_s)
        for found in measure_cores(sorted(os.sched_getaffinity(0)), duration_s)
    ]


def check_latency(found: CoreLatency, *, period_s: float, deadline_s: float) -> ReportLine:
    """Check the latency of a core against a cell's control period and shortest deadline [s]."""
    p50, p999 = np.percentile(found.late_s, [50.0, 99.9])
    longest_s = max(found.late_s)
    check = f"latency, core {found.core}"
    priority = f"SCHED_FIFO {PRIORITY}" if found.is_realtime else "ordinary priority"
    text = (
        f"{len(found.late_s)} wake-ups with {priority}: {1e6 * p50:.0f} us late at the median, "
        f"{1e6 * p999:.0f} at 99.9 %, {1e6 * longest_s:.0f} at most"
    )
    if longest_s <= period_s:
        return passed(check, text)
    text = f"{text}; {CAUSES[found.cause]}"
    if longest_s <= deadline_s:
        found_text = f"{text}; the control period is {1e3 * period_s:g} ms"
        return finding(check, "WARN", found_text, "latency")
    text = f"{text}; the arm would have held: a deadline is {1e3 * deadline_s:g} ms"
    return finding(check, "FAIL", text, "latency")


def measure_cores(cores: list[int], duration_s: float) -> list[CoreLatency]:
    """Measure cores at the same time, for a duration [s]."""
    context, found = mp.get_context("spawn"), []
    pipes = [context.Pipe(duplex=False) for _ in cores]
    processes = [
        context.Process(target=_measure, args=(core, duration_s, pipe), daemon=True)
        for core, (_, pipe) in zip(cores, pipes, strict=True)
    ]
    for process in processes:
        process.start()
    for (receiver, sender), process in zip(pipes, processes, strict=True):
        sender.close()
        found.append(receiver.recv())
        process.join()
    return found


def _measure(core: int, duration_s: float, result: Connection) -> None:
    """Wake once a millisecond on a core; send its latency."""
    os.sched_setaffinity(0, {core})
    lock_memory()
    take_realtime_priority()
    gc.disable()
    late_ns: list[int] = []
    longest_ns, longest_waited_ns = -1, 0
    due_ns = time.monotonic_ns() + PERIOD_NS
    end_ns = due_ns + round(duration_s * NS_PER_S)
    while due_ns < end_ns:
        before_ns = waited_ns()
        time.sleep(max(due_ns - time.monotonic_ns(), 0) / NS_PER_S)
        now_ns = time.monotonic_ns()
        late_ns.append(now_ns - due_ns)
        if late_ns[-1] > longest_ns:
            longest_ns, longest_waited_ns = late_ns[-1], waited_ns() - before_ns
        due_ns += PERIOD_NS * max(1, -(-(now_ns - due_ns) // PERIOD_NS))  # a missed one is over
    has_waited = longest_waited_ns > WAITED_SHARE * longest_ns
    late_s = tuple(each / NS_PER_S for each in late_ns)
    cause: LatencyCause = "other work" if has_waited else "the core"
    result.send(CoreLatency(core, late_s, has_realtime_priority(), cause))
