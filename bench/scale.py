"""How many cells and subscribers a machine carries: `python -m bench.scale`.

Every cell is simulated in real processes.
- Pressing: each cell presses on its plate, its sensor at 500 Hz. A subscriber is a session of its
  own that receives every message of the first cell. The cells hold their deadlines if no loop was
  late and no arm held.
- In a tree: no cell is armed, and the hub of each is connected to the first cell's, where a monitor
  receives the wrenches of all. Rates are a tenth, so that eight cells leave the hubs time. The
  cells hold their deadlines if no loop was late.

    python -m bench.scale                                every case
    python -m bench.scale --write                        the same into docs/realtime.md
    python -m bench.scale --cells 2 --seconds 600        one case
    python -m bench.scale --cells 4 --tree
"""

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from rich.console import Console
from rich.markdown import Markdown

from bench.bare_bus import opened_session, started
from bench.chain.cell import PRESSING, press, why_held
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
from tools.figures import replace_block

ROOT = Path(__file__).resolve().parent.parent
DEMO = ROOT / "cells" / "demo.yaml"
SECONDS, LONG_S = 20.0, 600.0
RATES = {"rates.sensor_hz": 500, "rates.control_hz": 250, "rates.robot_hz": 250}
TREE_SHARE = 0.1  # of these rates
WITHIN_S = 180.0  # eight cells start on two cores
OBSERVE_S = 0.25  # a fourth of the time for which a late step stays in the health
# The simulated robot's process is the sensor as well.
OF_PROCESSES = tuple(role for role in topics.ROLES if role != "sensor")


@dataclass(frozen=True, slots=True)
class ScaleCase:
    """Cells at the same time."""

    cells: int
    subscribers: int = 0  # of the first cell
    tree: bool = False
    duration_s: float = SECONDS


PRESSED = [
    *(ScaleCase(1, subscribers) for subscribers in (0, 10, 25, 50)),
    ScaleCase(2),
    ScaleCase(2, duration_s=LONG_S),
    ScaleCase(3),
]
TREES = [ScaleCase(cells, tree=True) for cells in (1, 2, 4, 8)]
CPU = ("processor, % of a core", "of it the hubs", "longest gap between steps")
HEADS = {
    False: ("cells, subscribers, seconds", *CPU, "deadlines"),
    True: (
        "cells in a tree, at a tenth of the rates",
        *CPU,
        "least rate of a wrench at the top",
        "deadlines",
    ),
}


@dataclass(slots=True)
class ScaleRun:
    """Measurements of a case."""

    case: ScaleCase
    load: dict[str, Load] = field(default_factory=dict)  # by cell and process
    longest_gap_s: float = 0.0  # between two steps of any loop of the chain
    top_hz: float = 0.0  # least rate of a cell's wrenches at the top of a tree
    late: str = ""  # the first loop that was late, or why an arm held; empty: none

    def cpu_pct(self, of: str = "") -> float:
        """Return the processor time of the processes whose name ends with a word."""
        return sum(load.cpu_pct for name, load in self.load.items() if name.endswith(of))

    @property
    def row(self) -> list[str]:
        """Row of the page."""
        case = self.case
        pressing = f"{case.cells}, {case.subscribers}, {case.duration_s:g}"
        return [
            str(case.cells) if case.tree else pressing,
            f"{self.cpu_pct():.0f}" if self.load else "-",
            f"{self.cpu_pct('hub'):.0f}" if self.load else "-",
            f"{1e3 * self.longest_gap_s:.0f} ms",
            *([f"{self.top_hz:.0f} Hz"] if case.tree else []),
            self.late or "all held",
        ]


def run(case: ScaleCase) -> ScaleRun:
    """Start the cells of a case and observe them for its interval."""
    found = ScaleRun(case)
    with ExitStack() as exits:
        configs = _configs(case)
        clients = [_started(config, exits) for config in configs]
        pids = {
            f"{client.config.cell} {role}": client.feed(topics.HEALTH[role])(WITHIN_S).pid
            for client in clients
            for role in OF_PROCESSES
        }
        if case.subscribers:
            exits.enter_context(started(subscribe, configs[0], case.subscribers))
        try:
            for client in () if case.tree else clients:
                press(client, "adaptive")
            with counted(configs, found), measured(pids, found.load):
                _observe(clients, found)
        except ForcemeshError as error:  # not armed, or a topic that a client no longer receives
            found.late = str(error)
    return found


def _configs(case: ScaleCase) -> list[CellConfig]:
    found: list[CellConfig] = []
    for number in range(1, case.cells + 1):
        changes: dict[str, Any] = {
            "cell": f"bench-scale-{number}",
            "bus.endpoint": f"tcp/127.0.0.1:{free_port()}",
            **{name: rate * (TREE_SHARE if case.tree else 1) for name, rate in RATES.items()},
        }
        if case.tree:
            changes["force.approach_m_s"] = 0.002  # what a loop with this delay permits
        if case.tree and found:
            top = found[0]
            changes["bus.upstream"] = {"endpoint": top.bus.endpoint, "cell": top.cell}
        found.append(load_cell(DEMO, changes))
    return found


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


@contextmanager
def counted(configs: list[CellConfig], found: ScaleRun) -> Iterator[None]:
    """Count the wrenches of all cells of a tree at its top during the block."""
    if not found.case.tree:
        yield
        return
    counts: Counter[str] = Counter()
    names = [f"{config.cell}/{topics.WRENCH.key}" for config in configs]
    with opened_session(configs[0]) as session:
        session.declare_subscriber(
            f"*/{topics.WRENCH.key}", lambda sample: counts.update([str(sample.key_expr)])
        )
        began_s, before = time.monotonic(), dict(counts)
        yield
        took_s = time.monotonic() - began_s
        found.top_hz = min(counts[name] - before.get(name, 0) for name in names) / took_s


def _observe(clients: list[ConfiguredCell], found: ScaleRun) -> None:
    """Note late loops and holds until the end of the interval, or until an arm holds."""
    end_s = time.monotonic() + found.case.duration_s
    while time.monotonic() < end_s:
        time.sleep(OBSERVE_S)
        for client in clients:
            for role in OF_PROCESSES:
                note(found, role, client.feed(topics.HEALTH[role])())
            if not found.case.tree and (held := why_held(client, (PRESSING,))):
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
    least = min((getattr(each.case, other) for each in runs), default=0)
    kept = [each for each in runs if not each.late and getattr(each.case, other) == least]
    counts = [getattr(each.case, count) for each in kept]
    if len(set(counts)) < 2:
        return None
    return float(np.polyfit(counts, [each.cpu_pct() for each in kept], 1)[0])


def page(runs: list[ScaleRun]) -> str:
    """Return the tables and the fitted costs as Markdown."""
    text = [f"{os.cpu_count()} cores; {SECONDS:g} s each where the table does not state it."]
    for tree, head in HEADS.items():
        shown = [each for each in runs if each.case.tree == tree]
        if shown:
            text += ["", as_markdown(head, [each.row for each in shown])]
        fitted = {count[:-1]: cost(shown, count) for count in ("cells", "subscribers")}
        costs = [f"{pct:.1f} % of a core for each {one}" for one, pct in fitted.items() if pct]
        if costs:
            text += ["", f"By least squares over the runs that held: {', '.join(costs)}."]
    return "\n".join(text)


def main() -> None:
    """Measure, and print the tables or write them into their page."""
    parser = argparse.ArgumentParser(prog="python -m bench.scale", description=__doc__)
    parser.add_argument("--cells", type=int, help="only this number of cells")
    parser.add_argument("--subscribers", type=int, default=0, help="of the first cell")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of the measurement")
    parser.add_argument("--tree", action="store_true", help="not armed, below the first cell's hub")
    parser.add_argument("--write", action="store_true", help="every case, into docs/realtime.md")
    given = parser.parse_args()
    if given.write and given.cells:
        parser.error("--write is of every case, without --cells")
    os.environ.pop(ENDPOINT_VARIABLE, None)
    one = ScaleCase(given.cells or 0, given.subscribers, given.tree, given.seconds)
    runs = []
    for case in [one] if given.cells else (*PRESSED, *TREES):
        runs.append(run(case))
        sys.stderr.write(f"{' | '.join(runs[-1].row)}\n")
    if given.write:
        command = "python -m bench.scale --write"
        replace_block(ROOT / "docs" / "realtime.md", "scale", page(runs), command)
    else:
        Console().print(Markdown(page(runs)))


if __name__ == "__main__":
    main()
