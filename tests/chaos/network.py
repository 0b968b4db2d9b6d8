"""Network fault injection: each process of a cell in its own network namespace.

`python -m tests.chaos.network [--cell demo] [--only robot/link-down] [--write]`.
Exit codes: 0 all bounds met, 1 a bound violated, 77 not testable on this machine.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from common.config.cell import CellConfig
from launch.processes import EMULATOR, processes_of
from launch.started_process import ProcessSpec
from tests.chaos.common_net import ROOT, make_cell, run_guarded, table
from tests.chaos.network_faults import FAULTS, NetworkFault
from tests.chaos.network_judge import TrialBounds
from tests.chaos.network_lab import CANNOT_RUN, Cable, Lab, enter_own_namespace, why_not
from tests.chaos.network_proxy import through_proxy
from tests.chaos.network_trials import (
    CABLE,
    HEAD,
    NetworkTrial,
    Row,
    bounds_of,
    grid,
    is_selected,
    played,
)
from tools.figures import replace_block

PAGE = ROOT / "docs" / "chaos-network.md"
TEMPLATES = ("demo", "demo-tcp")
PROXY = "proxy"
COMMAND = "python -m tests.chaos.network --write"


def hosts_of(cell: CellConfig, lab: Lab) -> tuple[list[ProcessSpec], list[Cable]]:
    """Assign each process of a cell a host; return the processes and the wires."""
    table_of = processes_of(cell)
    wires = [lab.host(process.name) for process in table_of]
    if cell.gateway is not None:
        wires.append(lab.cable(CABLE, "robot", "sensor"))
    processes = []
    for process in table_of:
        words = process.arguments
        if process.module == EMULATOR:
            words = (*words, "--address", "10.78.0.2")
        argv = (*lab.hosts[process.name].nsenter, sys.executable, "-m", process.module, *words)
        processes.append(replace(process, argv=argv))
    return processes, wires


def trials_on(cell: CellConfig, wires: list[Cable]) -> Iterator[NetworkTrial]:
    """Yield every fault on every wire."""
    for wire in wires:
        for name, fault in FAULTS.items():
            yield trial_of(name, fault, wire, bounds_of(cell, is_cable=wire.name == CABLE))


def trial_of(name: str, fault: NetworkFault, wire: Cable, bounds: TrialBounds) -> NetworkTrial:
    """Return one fault on one wire."""
    return NetworkTrial(
        wire=wire.name,
        fault=name,
        begin=lambda: fault.begin(wire),
        end=lambda: fault.end(wire),
        lasts_s=fault.lasts_s,
        # A lost connection to the hub is re-established; the controller's begins with a hello.
        ends="held" if name == "reset" and wire.name == CABLE else fault.ends,
        bounds=bounds,
    )


def in_namespaces(template: str, only: str, seed: int) -> Iterator[Row]:
    """Run a cell in namespaces with all selected trials."""
    with ExitStack() as exits:
        folder = Path(exits.enter_context(tempfile.TemporaryDirectory(prefix="forcemesh-chaos-")))
        lab = exits.enter_context(Lab())
        overrides: dict[str, object] = {
            "cell": f"chaos-{template}", "bus.endpoint": "tcp/10.77.0.1:7447",
            "bus.insecure": True,  # isolated in its own namespaces
        }  # fmt: skip
        if template == "demo-tcp":
            overrides["gateway.host"] = "10.78.0.2"
        cell, path = make_cell(template, folder, overrides)
        processes, wires = hosts_of(cell, lab)
        processes = [
            replace(process, argv=(*process.argv, "--cell", str(path))) for process in processes
        ]
        # The second cell tests the controller's cable; its wires to the hub equal the first's.
        wires_to_test = [w for w in wires if cell.gateway is None or w.name in (CABLE, "robot")]
        trials = [trial for trial in trials_on(cell, wires_to_test) if is_selected(trial, only)]
        yield from played(template, cell, path, processes=processes, trials=trials, seed=seed)


def summary(rows: list[Row], seed: int, took_s: float) -> str:
    """Return a one-line summary."""
    wrong = sum(bool(row.verdict.mistakes) for row in rows)
    held = sum(row.verdict.outcome == "held" for row in rows)
    fastest_mm_s = 1e3 * max((row.verdict.fastest_m_s for row in rows), default=0.0)
    return (
        f"{len(rows)} trials, {held} held, {len(rows) - held} went on, {wrong} out of bounds; "
        f"commands executed after the fault was removed: {sum(r.verdict.stale for r in rows)}; "
        f"fastest flange {fastest_mm_s:.0f} mm/s; seed {seed}, {took_s:.0f} s"
    )


def main() -> int:
    """Return the exit code of a run."""
    arguments = _arguments()
    namespaces = [name for name in TEMPLATES if arguments.cell in ("", name)]
    if namespaces and (reason := why_not()):
        print(f"NOTHING WAS TESTED: {reason}", file=sys.stderr)
        return CANNOT_RUN
    if namespaces:
        enter_own_namespace("tests.chaos.network")
    return run_guarded(lambda: play(arguments, namespaces))


def play(given: argparse.Namespace, namespaces: list[str]) -> int:
    """Run the trials, print and write the table, return the exit code."""
    began_s, rows = time.monotonic(), list[Row]()
    for template in namespaces:
        rows += in_namespaces(template, given.only, given.seed)
    if given.cell in ("", PROXY):
        rows += through_proxy(given.only, given.seed)
    line = summary(rows, given.seed, time.monotonic() - began_s)
    title = f"Faults on cables, {os.cpu_count()} cores"
    print("\n" + table(title, HEAD, [row.cells() for row in rows]) + "\n" + line)
    if given.write and rows:
        text = table(title, *grid(row.result() for row in rows))
        replace_block(PAGE, "chaos-network", f"{text}\n{line}", COMMAND)
    return 0 if rows and not any(row.verdict.mistakes for row in rows) else 1


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="tests.chaos.network", description=__doc__)
    parser.add_argument("--cell", default="", choices=("", *TEMPLATES, PROXY))
    parser.add_argument("--only", default="", metavar="WIRE/FAULT", help="this trial alone")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="write docs/chaos-network.md")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
