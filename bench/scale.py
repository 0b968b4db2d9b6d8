"""How many cells and subscribers a machine carries: `python -m bench.scale`.

Every cell is simulated in real processes, senses at 500 Hz and presses on its plate. A subscriber
is a session of its own that receives every message of the first cell. A cell holds its deadlines if
no loop was late and the arm never held.

    python -m bench.scale                                every case
    python -m bench.scale --cells 2 --seconds 600        one case
"""

import argparse
import os
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zenoh
from rich.console import Console
from rich.markdown import Markdown

from bench.bare_bus import opened_session, started
from bench.chain.cell import PRESSING, WITHIN_S, press, why_held
from bench.chain.load import Load, measured
from bench.tables import as_markdown
from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.errors import ForcemeshError
from forcemesh.messages import Health
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from launch.processes import Supervisor
from tests.chaos.common_net import free_port

DEMO = Path(__file__).resolve().parent.parent / "cells" / "demo.yaml"
SECONDS = 20.0
OBSERVE_S = 0.25  # a fourth of the time for which a late step stays in the health
CASES = ((1, 0), (1, 10), (1, 25), (1, 50), (2, 0), (3, 0))  # cells, subscribers of the first
HEAD = (
    "cells, subscribers",
    "processor, % of a core",
    "of it the hubs",
    "longest gap between steps",
    "deadlines",
)
# The simulated robot's process is the sensor as well.
OF_PROCESSES = tuple(role for role in topics.ROLES if role != "sensor")


@dataclass(slots=True)
class ScaleRun:
    """Measurements of some cells that press at the same time."""

    cells: int
    subscribers: int
    load: dict[str, Load] = field(default_factory=dict)  # by cell and process
    longest_gap_s: float = 0.0  # between two steps of any loop of the chain
    late: str = ""  # the first loop that was late, or why an arm held; empty: none

    def cpu_pct(self, of: str = "") -> float:
        """Return the processor time of the processes whose name ends with a word."""
        return sum(load.cpu_pct for name, load in self.load.items() if name.endswith(of))

    @property
    def row(self) -> list[str]:
        """Row of the page."""
        return [
            f"{self.cells}, {self.subscribers}",
            f"{self.cpu_pct():.0f}" if self.load else "-",
            f"{self.cpu_pct('hub'):.0f}" if self.load else "-",
            f"{1e3 * self.longest_gap_s:.0f} ms",
            self.late or "all held",
        ]


def run(cells: int, subscribers: int, duration_s: float) -> ScaleRun:
    """Let cells press at the same time and observe them for an interval."""
    found = ScaleRun(cells, subscribers)
    with ExitStack() as exits:
        configs = [_cell(number) for number in range(1, cells + 1)]
        clients = [_started(config, exits) for config in configs]
        pids = {
            f"{client.config.cell} {role}": client.feed(topics.HEALTH[role])(WITHIN_S).pid
            for client in clients
            for role in OF_PROCESSES
        }
        if subscribers:
            exits.enter_context(started(subscribe, configs[0], subscribers))
        try:
            for client in clients:
                press(client, "adaptive")
            with measured(pids, found.load):
                _observe(clients, duration_s, found)
        except ForcemeshError as error:  # not armed, or a topic that a client no longer receives
            found.late = str(error)
    return found


def _cell(number: int) -> CellConfig:
    name = f"bench-scale-{number}"
    changes = {"cell": name, "bus.endpoint": f"tcp/127.0.0.1:{free_port()}", "rates.sensor_hz": 500}
    return load_cell(DEMO, changes)


def _started(config: CellConfig, exits: ExitStack) -> ConfiguredCell:
    exits.enter_context(Supervisor(config)).wait_ready(WITHIN_S)
    client = exits.enter_context(ConfiguredCell(config, commander="operator"))
    client.wait_ready(WITHIN_S)
    return client


def subscribe(cell: CellConfig, count: int) -> None:
    """Be so many subscribers of everything, until the process is terminated."""
    sessions = [opened_session(cell) for _ in range(count)]
    everything = [
        session.declare_subscriber(f"{cell.cell}/**", zenoh.handlers.RingChannel(1))
        for session in sessions
    ]
    while everything:
        time.sleep(1.0)


def _observe(clients: list[ConfiguredCell], duration_s: float, found: ScaleRun) -> None:
    """Note late loops and holds until the end of the interval, or until an arm holds."""
    end_s = time.monotonic() + duration_s
    while time.monotonic() < end_s:
        time.sleep(OBSERVE_S)
        for client in clients:
            for role in OF_PROCESSES:
                note(found, role, client.feed(topics.HEALTH[role])())
            if held := why_held(client, (PRESSING,)):
                found.late = f"an arm held: {held}"
                return


def note(found: ScaleRun, role: str, health: Health) -> None:
    """Note the longest gap of a loop of the chain, without the hub's, and the first overrun."""
    if role != "hub":
        found.longest_gap_s = max(found.longest_gap_s, health.longest_gap_s)
    if health.overruns and not found.late:
        found.late = f"{role} was late: {health.late_cause}"


def cost(runs: list[ScaleRun], count: str) -> float | None:
    """Return the processor time per cell, or per subscriber, by least squares [% of a core].

    Only of runs that held their deadlines: a late loop does less. None when there is only one.
    """
    other = {"cells": "subscribers", "subscribers": "cells"}[count]
    least = min(getattr(each, other) for each in runs)
    kept = [each for each in runs if not each.late and getattr(each, other) == least]
    counts = [getattr(each, count) for each in kept]
    if len(set(counts)) < 2:
        return None
    return float(np.polyfit(counts, [each.cpu_pct() for each in kept], 1)[0])


def page(runs: list[ScaleRun], duration_s: float) -> str:
    """Return the table and the fitted costs as Markdown."""
    text = [as_markdown(HEAD, [each.row for each in runs])]
    fitted = {count[:-1]: cost(runs, count) for count in ("cells", "subscribers")}
    costs = [f"{pct:.1f} % of a core for each {one}" for one, pct in fitted.items() if pct]
    text += ["", f"By least squares over the runs that held: {', '.join(costs)}."] if costs else []
    return "\n".join([f"{os.cpu_count()} cores, {duration_s:g} s each.", "", *text])


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.scale", description=__doc__)
    parser.add_argument("--cells", type=int, help="only this number of cells")
    parser.add_argument("--subscribers", type=int, default=0, help="of the first cell")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each measurement")
    options = parser.parse_args()
    os.environ.pop(ENDPOINT_VARIABLE, None)
    runs = []
    for cells, subscribers in [(options.cells, options.subscribers)] if options.cells else CASES:
        runs.append(run(cells, subscribers, options.seconds))
        sys.stderr.write(f"{' | '.join(runs[-1].row)}\n")
    Console().print(Markdown(page(runs, options.seconds)))


if __name__ == "__main__":
    main()
