"""The cell's chain compared with bare ones, and the times of a step in it.

Cell and bare chains are measured in turn, several times, in one run; what is compared are ratios
of medians. Rates, busy loops at the same time, and SCHED_FIFO are varied.
"""

import os
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from statistics import median

import numpy as np

from bench.chain import bare, cell, steps
from bench.chain.load import Load, busy_loops, engine_us
from bench.harness import Options
from bench.results import ROOT, Row, Table, table
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.frames import Array
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from tests.chaos.common_net import free_port

DEMO = ROOT / "cells" / "demo.yaml"
CHAINS: dict[bare.Kind, str] = {
    "zenoh": "bare chain over the cell's router",
    "pyzmq": "bare chain over pyzmq",
    "tcp": "bare chain over TCP",
}
PERCENTILES = {"p50_us": 50.0, "p99_us": 99.0, "p99.9_us": 99.9, "max_us": 100.0}
# Ratio of the cell to the bare chain over Zenoh that is a regression: the one on docs/chain.md and
# a quarter more, which covers other machines and days; times may double without SCHED_FIFO, which
# not every machine grants.
MOST_RATIO = {"cpu": 3.6, "p50": 3.2, "p99": 3.2}
ROUNDS, SECONDS = (5, 3), (8.0, 6.0)  # of a whole run, and of a quick one
BUSIEST = 4  # threads that are named

TIMES = dict.fromkeys(PERCENTILES, ".0f")
RATIOS = {"cpu_ratio": ".2f", "p50_ratio": ".2f", "p99_ratio": ".2f"}
LIMIT = {"quantity": "", "limit": "g", "ratio": ".2f", "met": ""}
CHAIN = {"chain": "", "processor_core_pct": ".0f", **TIMES, **RATIOS}
PROCESS = {"process": "", "processor_core_pct": ".0f", "busiest_threads": "", "wakeups_hz": ".0f"}
CASE = {"sensor_hz": "d", "control_hz": "d", "busy_loops": "d", "priority": "",
        "processor_core_pct": ".0f", "p50_us": ".0f", "p99_us": ".0f", "max_us": ".0f",
        **RATIOS, "held": ""}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Case:
    """What is varied between comparisons."""

    sensor_hz: int = 500
    control_hz: int = 250
    busy_loops: int = 0
    realtime: bool = True

    def cell(self) -> CellConfig:
        """Return the cell with these rates, at a free port."""
        return load_cell(
            DEMO,
            {
                "cell": "bench-chain",
                "bus.endpoint": f"tcp/127.0.0.1:{free_port()}",
                "rates.sensor_hz": self.sensor_hz,
                "rates.control_hz": self.control_hz,
            },
        )


VARIED = [
    Case(*rates, busy, realtime)
    for rates, busy, realtime in product(
        ((500, 250), (1000, 250), (1000, 500)), (0, 4), (True, False)
    )
]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Measurements of a case: one of the cell and one of each bare chain per round."""

    case: Case
    cells: list[cell.CellRun]  # in which the arm pressed until the end; may be none
    held: list[str]  # why the arm held in the others
    bares: dict[bare.Kind, list[tuple[Array, dict[str, Load]]]]
    engine_pct: float  # of one core: MuJoCo's own steps

    def row(self) -> Row:
        """Return the cell's processor time, MuJoCo's steps left out, and its times."""
        loads, times = [run.load for run in self.cells], [run.chain_us for run in self.cells]
        return {"chain": "cell", **_row(loads, times, self.engine_pct)}

    def bare_row(self, kind: bare.Kind) -> Row:
        """Return the same of a bare chain, and the ratios of the cell to it."""
        loads, times = [load for _, load in self.bares[kind]], [us for us, _ in self.bares[kind]]
        found, ours = _row(loads, times), self.row()
        ratios = {f"{p}_ratio": ours[f"{p}_us"] / found[f"{p}_us"] for p in ("p50", "p99")}
        cpu = ours["processor_core_pct"] / found["processor_core_pct"]
        return {"chain": CHAINS[kind], **found, "cpu_ratio": cpu, **ratios}

    def case_row(self) -> Row:
        """Return the case with its result relative to the bare chain over Zenoh."""
        priority = "SCHED_FIFO" if self.case.realtime else "ordinary"
        row = {**asdict(self.case), "priority": priority, "held": "; ".join(self.held)}
        return {**self.bare_row("zenoh"), **self.row(), **row} if self.cells else row


def _row(loads: Sequence[dict[str, Load]], times: Sequence[Array], less_pct: float = 0.0) -> Row:
    """Return medians over the rounds."""
    pct = median(sum(each.cpu_pct for each in load.values()) for load in loads) - less_pct
    us = {
        name: median(float(np.percentile(each, at)) for each in times)
        for name, at in PERCENTILES.items()
    }
    return {"processor_core_pct": pct, **us}


def compare(case: Case, rounds: int, duration_s: float) -> Comparison:
    """Measure cell and bare chains in turn."""
    found = Comparison(case, [], [], {kind: [] for kind in CHAINS}, engine_us() / 10.0)
    with busy_loops(case.busy_loops):
        for _ in range(rounds):
            run = cell.run(case.cell(), duration_s, law="adaptive", realtime=case.realtime)
            if run.held:
                found.held.append(run.held)
            else:
                found.cells.append(run)
            for kind, runs in found.bares.items():
                hub, rate_hz = case.cell(), float(case.control_hz)
                runs.append(bare.run(kind, hub, rate_hz, duration_s, realtime=case.realtime))
    return found


def measure(options: Options) -> dict[str, Table]:
    """Compare the usual case several times, and the others once."""
    os.environ.pop(ENDPOINT_VARIABLE, None)
    rounds, seconds = ROUNDS[options.quick], SECONDS[options.quick]
    usual = compare(Case(), rounds, seconds)
    if not usual.cells:
        sys.exit(f"the arm held in every round: {'; '.join(usual.held)}")
    others = () if options.quick else VARIED[1:]
    cases = [usual, *(compare(case, 1, seconds) for case in others)]
    return {
        "limits": table(LIMIT, limits(usual.bare_row("zenoh"))),
        "chains": table(CHAIN, [usual.row(), *map(usual.bare_row, CHAINS)]),
        "hops": table({"hop": "", **TIMES}, hops(usual.cells)),
        "processes": table(PROCESS, processes(usual.cells)),
        "dropped": table({"counter": "", "count": "d"}, dropped(usual.cells)),
        "cases": table(CASE, [each.case_row() for each in cases]),
        "steps": table(steps.COLUMNS, map(steps.row, steps.PARTS)),
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
        yield {"hop": hop} | {n: float(np.percentile(us, at)) for n, at in PERCENTILES.items()}


def processes(runs: Sequence[cell.CellRun]) -> Iterator[Row]:
    """Yield the load of each process, medians over the rounds."""
    for role in runs[0].load:
        loads = [run.load[role] for run in runs]
        threads: Mapping[str, float] = loads[-1].threads_pct
        busiest = sorted(threads.items(), key=lambda item: -item[1])[:BUSIEST]
        yield {
            "process": role,
            "processor_core_pct": median(load.cpu_pct for load in loads),
            "busiest_threads": ", ".join(f"{name} {pct:.0f}" for name, pct in busiest),
            "wakeups_hz": median(load.wakeups_hz for load in loads),
        }


def dropped(runs: Sequence[cell.CellRun]) -> Iterator[Row]:
    """Yield the samples that reached the robot, and the counters of those that were not used."""
    totals = Counter({"samples that reached the robot": sum(len(run.chain_us) for run in runs)})
    for run in runs:
        totals.update(run.dropped)
    for name, count in totals.items():
        yield {"counter": name, "count": count}
