"""The page of the comparison, docs/chain.md."""

import os
from statistics import median

import numpy as np

from bench.chain import bare
from bench.chain.compare import PERCENTILES, Comparison

COMMAND = 'make bench-chain ARGS="--full --write"'
CHAINS: dict[bare.Kind, str] = {
    "zenoh": "bare chain over the cell's router",
    "pyzmq": "bare chain over pyzmq",
    "tcp": "bare chain over TCP",
}


STEPS = (
    "A cell that presses on the virtual clock, all services in one process; the simulated robot "
    "without MuJoCo's steps. A loop is a thousand turns of plain arithmetic, timed after each step."
)


def page(found: list[Comparison], steps: str) -> str:
    """Return the page as Markdown; `steps` is the table of the times of a step."""
    usual, *varied = found
    parts = [
        "# From the sensor to the robot, compared with processes that only forward messages",
        _about(usual),
        "![Times from the sensor to the robot, and processor time by process](pictures/chain.png)",
        f"## {usual.case}",
        _chains(usual),
        "## Hops of the cell",
        _hops(usual),
        "## Processes of the cell",
        _processes(usual),
        _dropped(usual),
        "## Processor time of a step",
        STEPS,
        steps,
    ]
    if varied:
        parts += ["## Other rates, other work on the machine, no SCHED_FIFO", _cases(found)]
    return "\n\n".join(parts) + "\n"


def _about(each: Comparison) -> str:
    return (
        f"Medians of {len(each.cells)} rounds, in turn, on {os.cpu_count()} cores; compare the "
        "ratios. The cell presses with the adaptive law, with its hub, without panel and recorder. "
        f"Its processor time leaves out MuJoCo's own steps, {each.engine_pct:.0f} % of a core. A "
        "bare chain is a source, three forwarders and a sink at the rate of control, without "
        "decoding, with Zenoh's own number of threads. It begins when the source sends, the cell's "
        "when the sensor has its sample. A client reads four topics of the cell at the same time, "
        "which the hub forwards as well."
    )


def _chains(each: Comparison) -> str:
    names = [
        "",
        "processor, % of a core",
        *(f"{name} us" for name in PERCENTILES),
        "cell: CPU",
        "p50",
        "p99",
    ]
    lines = [_row(names), _row(["---", *["---:"] * (len(names) - 1)])]
    us = [f"{each.cell_us(at):.0f}" for at in PERCENTILES.values()]
    lines.append(_row(["cell", f"{each.cell_cpu_pct():.0f}", *us, "", "", ""]))
    for kind, name in CHAINS.items():
        us = [f"{each.bare_us(kind, at):.0f}" for at in PERCENTILES.values()]
        ratios = [
            each.cell_cpu_pct() / each.bare_cpu_pct(kind),
            *(each.cell_us(at) / each.bare_us(kind, at) for at in (50.0, 99.0)),
        ]
        times = [f"x {ratio:.2f}" for ratio in ratios]
        lines.append(_row([name, f"{each.bare_cpu_pct(kind):.0f}", *us, *times]))
    return "\n".join(lines)


def _hops(each: Comparison) -> str:
    lines = [
        _row(["from, to", *(f"{name} us" for name in PERCENTILES)]),
        _row(["---", *["---:"] * 4]),
    ]
    for hop, us in each.hops_us().items():
        lines.append(_row([hop, *(f"{np.percentile(us, at):.0f}" for at in PERCENTILES.values())]))
    return "\n".join(lines)


def _processes(each: Comparison) -> str:
    lines = [
        _row(["process", "% of a core", "of it its busiest threads", "wake-ups a second"]),
        _row(["---", "---:", "---", "---:"]),
    ]
    for role in each.cells[0].load:
        loads = [run.load[role] for run in each.cells]
        threads = sorted(loads[-1].threads_pct.items(), key=lambda item: -item[1])[:4]
        named = ", ".join(f"{name} {share:.0f}" for name, share in threads)
        cpu_pct, wakeups_hz = (
            median(load.cpu_pct for load in loads),
            median(load.wakeups_hz for load in loads),
        )
        lines.append(_row([role, f"{cpu_pct:.0f}", named, f"{wakeups_hz:.0f}"]))
    return "\n".join(lines)


def _dropped(each: Comparison) -> str:
    samples = sum(len(run.chain_us) for run in each.cells)
    totals: dict[str, int] = {}
    for run in each.cells:
        for name, count in run.dropped.items():
            totals[name] = totals.get(name, 0) + count
    listed = ", ".join(f"{name} {count}" for name, count in totals.items())
    held = (
        f"{len(each.held)} more rounds ended in a hold: {'; '.join(each.held)}."
        if each.held
        else ""
    )
    return f"Of {samples} samples that reached the robot in all rounds: {listed}. {held}".rstrip()


def _cases(found: list[Comparison]) -> str:
    lines = [
        _row(["case", "cell, % of a core", "p50 us", "p99 us", "max us", "CPU", "p50", "p99"]),
        _row(["---", *["---:"] * 7]),
    ]
    for each in found:
        if not each.cells:
            lines.append(_row([str(each.case), f"held: {'; '.join(each.held)}", *[""] * 6]))
            continue
        us = [f"{each.cell_us(at):.0f}" for at in (50.0, 99.0, 100.0)]
        ratios = [f"x {each.ratios()[name]:.2f}" for name in ("cpu", "p50", "p99")]
        lines.append(_row([str(each.case), f"{each.cell_cpu_pct():.0f}", *us, *ratios]))
    return "\n".join(lines)


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
