"""Cell and bare chains of one case, measured in turn, and the ratios of their medians."""

from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bench.chain import bare, cell
from bench.chain.load import Load, busy_loops, engine_us
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.frames import Array
from tests.chaos.common_net import free_port

DEMO = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
KINDS: tuple[bare.Kind, ...] = ("zenoh", "pyzmq", "tcp")
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
# Ratio of the cell to the bare chain over Zenoh that is a regression: the one on docs/chain.md and
# a quarter more, which covers other machines and days; times may double without SCHED_FIFO, which
# not every machine grants.
MOST_RATIO = {"cpu": 3.6, "p50": 3.2, "p99": 3.2}


@dataclass(frozen=True, slots=True)
class Case:
    """What is varied between comparisons."""

    sensor_hz: int = 500
    control_hz: int = 250
    busy_loops: int = 0
    realtime: bool = True

    def __str__(self) -> str:
        """Return the case in words."""
        loops = f"{self.busy_loops} busy loops" if self.busy_loops else "quiet"
        priority = "SCHED_FIFO" if self.realtime else "without SCHED_FIFO"
        return f"sensor {self.sensor_hz} Hz, control {self.control_hz} Hz, {loops}, {priority}"

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


@dataclass(frozen=True, slots=True)
class Comparison:
    """Measurements of a case: one of the cell and one of each bare chain per round."""

    case: Case
    cells: list[cell.CellRun]  # in which the arm pressed until the end; may be none
    held: list[str]  # why the arm held in the others
    bares: dict[bare.Kind, list[tuple[Array, dict[str, Load]]]]
    engine_pct: float  # of one core: MuJoCo's own steps

    def cell_cpu_pct(self) -> float:
        """Return the processor time of all processes of the cell, MuJoCo's steps left out."""
        return median(_cpu_pct(run.load) for run in self.cells) - self.engine_pct

    def bare_cpu_pct(self, kind: bare.Kind) -> float:
        """Return the processor time of all processes of a bare chain."""
        return median(_cpu_pct(load) for _, load in self.bares[kind])

    def cell_us(self, percentile: float) -> float:
        """Return the median over the rounds of a percentile of the chain [us]."""
        return median(float(np.percentile(run.chain_us, percentile)) for run in self.cells)

    def bare_us(self, kind: bare.Kind, percentile: float) -> float:
        """Return the same of a bare chain [us]."""
        return median(float(np.percentile(us, percentile)) for us, _ in self.bares[kind])

    def ratios(self) -> dict[str, float]:
        """Return the ratios of the cell to the bare chain over Zenoh."""
        times = {
            name: self.cell_us(percentile) / self.bare_us("zenoh", percentile)
            for name, percentile in PERCENTILES.items()
        }
        return {"cpu": self.cell_cpu_pct() / self.bare_cpu_pct("zenoh")} | times

    def excess(self) -> list[str]:
        """Return a line for each ratio above its limit."""
        ratios = self.ratios()
        return [
            f"{name}: the cell takes {ratios[name]:.2f} times the bare chain, limit {most:g}"
            for name, most in MOST_RATIO.items()
            if ratios[name] > most
        ]

    def hops_us(self) -> dict[str, Array]:
        """Return the times of each hop, all rounds together [us]."""
        every = [run.hops_us() for run in self.cells]
        return {name: np.concatenate([hops[name] for hops in every]) for name in every[0]}

    def numbers(self) -> dict[str, Any]:
        """Return everything as plain numbers; without those of the cell if it never pressed."""
        known = {"case": asdict(self.case), "held": self.held}
        if not self.cells:
            return known
        return known | {
            "ratios": self.ratios(),
            "engine_pct": self.engine_pct,
            "cell_cpu_pct": self.cell_cpu_pct(),
            "bare_cpu_pct": {kind: self.bare_cpu_pct(kind) for kind in self.bares},
            "cell_us": {name: self.cell_us(at) for name, at in PERCENTILES.items()},
            "bare_us": {
                kind: {name: self.bare_us(kind, at) for name, at in PERCENTILES.items()}
                for kind in self.bares
            },
            "hops_us": {
                hop: {name: float(np.percentile(us, at)) for name, at in PERCENTILES.items()}
                for hop, us in self.hops_us().items()
            },
            "rounds": [
                {
                    "samples": len(run.chain_us),
                    "dropped": run.dropped,
                    "load": {name: asdict(load) for name, load in run.load.items()},
                }
                for run in self.cells
            ],
        }


def compare(case: Case, rounds: int, duration_s: float) -> Comparison:
    """Measure cell and bare chains in turn."""
    cells: list[cell.CellRun] = []
    held: list[str] = []
    bares: dict[bare.Kind, list[tuple[Array, dict[str, Load]]]] = {kind: [] for kind in KINDS}
    engine_pct = engine_us() * 1e-6 * 1000.0 * 100.0  # a thousand ticks a second
    with busy_loops(case.busy_loops):
        for _ in range(rounds):
            run = cell.run(case.cell(), duration_s, law="adaptive", realtime=case.realtime)
            if run.held:
                held.append(run.held)
            else:
                cells.append(run)
            for kind, runs in bares.items():
                hub, rate_hz = case.cell(), float(case.control_hz)
                runs.append(bare.run(kind, hub, rate_hz, duration_s, realtime=case.realtime))
    return Comparison(case, cells, held, bares, engine_pct)


def _cpu_pct(load: dict[str, Load]) -> float:
    return sum(each.cpu_pct for each in load.values())
