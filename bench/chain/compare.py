"""The cell's chain compared with bare ones, and the times of a step in it.

Cell and bare chains are measured in turn, several times, in one run; what is compared are ratios
of medians. Rates, busy loops at the same time, and SCHED_FIFO are varied.

Steps are timed with all services in turn in one process on a virtual clock. Times are processor
time of the thread, so other processes disturb only the caches.
"""

import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from statistics import median
from time import thread_time_ns

import numpy as np

from bench.chain import bare, cell, levers
from bench.chain.load import Load, busy_loops, engine_us
from bench.harness import Options, Tables
from bench.results import ROOT, Row
from bench.stalls import armed
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.frames import Array
from forcemesh.messages import Law
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE

SETTLED_S, TIMED_S = 2.0, 4.0  # virtual time
PRESS_N = 20.0
PARTS: dict[str, tuple[str, str, Law]] = {  # role, cell file, law
    "wrench": ("wrench", "demo.yaml", "plain"),
    "regulator, plain law": ("regulator", "demo.yaml", "plain"),
    "regulator, adaptive law": ("regulator", "demo.yaml", "adaptive"),
    "arbiter": ("arbiter", "demo.yaml", "plain"),
    "gateway": ("robot", "demo-tcp.yaml", "plain"),
}


def step_row(name: str) -> Row:
    """Return the times of a part."""
    times_us = step_times_us(name)
    return {"part": name, "median_us": median(times_us), "lowest_us": min(times_us)}


def step_times_us(name: str, timed_s: float = TIMED_S) -> list[float]:
    """Return the times of all steps of a part while the arm presses in mode both [us]."""
    role, file, law = PARTS[name]
    world, client = armed(load_cell(ROOT / "cells" / file, {"sim.gap_m": 0.001}))
    client.force.start(PRESS_N, mode="both", law=law)
    world.advance(SETTLED_S)
    service, times_us = world.runners[role].service, list[float]()
    step = service.step

    def timed(now_ns: int) -> None:
        began_ns = thread_time_ns()
        step(now_ns)
        times_us.append((thread_time_ns() - began_ns) / 1e3)

    service.step = timed  # type: ignore[method-assign]
    world.advance(timed_s)
    return times_us


PERCENTILES = {"p50_us": 50.0, "p99_us": 99.0, "p99.9_us": 99.9, "max_us": 100.0}
# Ratio of the cell to the bare chain over Zenoh that is a regression: the one on docs/chain.md and
# a quarter more, which covers other machines and days; times may double without SCHED_FIFO, which
# not every machine grants.
MOST_RATIO = {"cpu": 3.6, "p50": 3.2, "p99": 3.2}
ROUNDS, SECONDS = (5, 3), (8.0, 6.0)  # of a whole run, and of a quick one
BUSIEST = 4  # threads that are named
SCHED_FIFO = "SCHED_FIFO"
USUAL = {"sensor_hz": 500, "control_hz": 250, "busy_loops": 0, "priority": SCHED_FIFO}
OTHERS = [
    {"sensor_hz": sensor_hz, "control_hz": control_hz, "busy_loops": busy, "priority": priority}
    for (sensor_hz, control_hz), busy, priority in product(
        ((500, 250), (1000, 250), (1000, 500)), (0, 4), (SCHED_FIFO, "ordinary")
    )
][1:]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Measurements of a case: one of the cell and one of each bare chain per round."""

    case: Row
    cells: list[cell.CellRun]  # in which the arm pressed until the end; may be none
    held: list[str]  # why the arm held in the others
    bares: dict[bare.ChainKind, list[tuple[Array, dict[str, Load]]]]
    engine_pct: float  # of one core: MuJoCo's own steps

    def row(self) -> Row:
        """Return the cell's processor time, MuJoCo's steps left out, and its times."""
        loads, times = [run.load for run in self.cells], [run.chain_us for run in self.cells]
        return {"chain": "cell", **_row(loads, times, self.engine_pct)}

    def bare_row(self, kind: bare.ChainKind) -> Row:
        """Return the same of a bare chain, and the ratios of the cell to it."""
        loads, times = [load for _, load in self.bares[kind]], [us for us, _ in self.bares[kind]]
        found, ours = _row(loads, times), self.row()
        compared = {"cpu": "processor_core_pct", "p50": "p50_us", "p99": "p99_us"}
        ratios = {f"{short}_ratio": ours[name] / found[name] for short, name in compared.items()}
        return {"chain": bare.CHAINS[kind], **found, **ratios}

    def case_row(self) -> Row:
        """Return the case with its result relative to the bare chain over Zenoh."""
        row = {**self.case, "held": "; ".join(self.held)}
        return {**self.bare_row("zenoh"), **self.row(), **row} if self.cells else row


def _row(loads: Sequence[dict[str, Load]], times: Sequence[Array], less_pct: float = 0.0) -> Row:
    """Return medians over the rounds."""
    pct = median(sum(each.cpu_pct for each in load.values()) for load in loads) - less_pct
    return {"processor_core_pct": pct, **_percentiles(times)}


def _percentiles(times_us: Sequence[Array]) -> Row:
    """Return medians over the rounds."""
    return {
        name: median(float(np.percentile(each, at)) for each in times_us)
        for name, at in PERCENTILES.items()
    }


def cell_of(case: Row) -> CellConfig:
    """Return the cell with the rates of a case, at a free port."""
    rates = {f"rates.{name}": case[name] for name in ("sensor_hz", "control_hz")}
    return cell.own_demo("bench-chain", rates)


def compare(case: Row, rounds: int, duration_s: float) -> Comparison:
    """Measure cell and bare chains in turn."""
    found = Comparison(case, [], [], {kind: [] for kind in bare.CHAINS}, engine_us() / 10.0)
    realtime, rate_hz = case["priority"] == SCHED_FIFO, float(case["control_hz"])
    with busy_loops(case["busy_loops"]):
        for _ in range(rounds):
            run = cell.run(cell_of(case), duration_s, law="adaptive", realtime=realtime)
            if run.held:
                found.held.append(run.held)
            else:
                found.cells.append(run)
            for kind, runs in found.bares.items():
                runs.append(bare.run(kind, cell_of(case), rate_hz, duration_s, realtime=realtime))
    return found


def measure(options: Options) -> Tables:
    """Compare the usual case several times, and the others once."""
    os.environ.pop(ENDPOINT_VARIABLE, None)
    rounds, seconds = ROUNDS[options.quick], SECONDS[options.quick]
    usual = compare(USUAL, rounds, seconds)
    if not usual.cells:
        sys.exit(f"the arm held in every round: {'; '.join(usual.held)}")
    others = () if options.quick else OTHERS
    cases = [usual, *(compare(case, 1, seconds) for case in others)]
    return {
        "limits": limits(usual.bare_row("zenoh")),
        "chains": [usual.row(), *map(usual.bare_row, bare.CHAINS)],
        "hops": hops(usual.cells),
        "processes": processes(usual.cells),
        "dropped": dropped(usual.cells),
        "cases": [each.case_row() for each in cases],
        "steps": map(step_row, PARTS),
        "levers": () if options.quick else levers.rows(rounds, seconds),
    }


def limits(row: Row) -> Iterator[Row]:
    """Yield the ratios that are limited."""
    for name, most in MOST_RATIO.items():
        ratio = row[f"{name}_ratio"]
        yield {"quantity": name, "limit": most, "ratio": ratio, "met": ratio <= most}


def hops(runs: Sequence[cell.CellRun]) -> Iterator[Row]:
    """Yield the times from each stage to the next, all rounds together."""
    every = [run.hops_us() for run in runs]
    for hop in every[0]:
        us = np.concatenate([each[hop] for each in every])
        yield {"hop": hop, **_percentiles([us])}


def processes(runs: Sequence[cell.CellRun]) -> Iterator[Row]:
    """Yield the load of each process, medians over the rounds."""
    for role, last in runs[-1].load.items():
        loads = [run.load[role] for run in runs]
        busiest = sorted(last.threads_pct.items(), key=lambda item: -item[1])[:BUSIEST]
        yield {
            "process": role,
            "processor_core_pct": median(load.cpu_pct for load in loads),
            "busiest_threads": ", ".join(f"{name} {pct:.0f}" for name, pct in busiest),
            "wakeups_hz": median(load.wakeups_hz for load in loads),
        }


def dropped(runs: Sequence[cell.CellRun]) -> list[Row]:
    """Return the samples that reached the robot, and the counters of those that were not used."""
    totals = Counter({"samples that reached the robot": sum(len(run.chain_us) for run in runs)})
    for run in runs:
        totals.update(run.dropped)
    return [{"counter": name, "count": count} for name, count in totals.items()]
