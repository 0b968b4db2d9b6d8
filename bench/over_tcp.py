"""Force release over gateway, TCP and the program in the emulated controller: every combination.

The emulated controller stops with E1117 at a motion that blends into the next one and is planned
for less than the least segment; `pessimistic` selects the worse interpretation of every open
question, among them an acceleration by time.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, get_args

from rich.console import Console
from rich.markdown import Markdown
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from typer import Option
from typer import run as run_typer

from bench.settling import MODES, STIFFNESSES_N_M
from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell, surface_of
from cli.demo.measures import Result, measure
from cli.demo.scenario import ScenarioError, ScenarioPlan, Trace, play_real, play_virtual
from common.config.cell import CellConfig
from forcemesh.messages import Host, Mode
from tools.figures import as_block_page
from tuning.gain_rule import tune

HOSTS: tuple[Host, ...] = get_args(Host)
LEAST_SEGMENTS_S = (0.030, 0.016)
MOTIONS_AHEAD = (1, 3)
STAYS_S = 5.0  # longer than the window in which the gateway counts

ROOT = Path(__file__).resolve().parent.parent
CELL = ROOT / "cells" / "demo-tcp.yaml"
PAGE = ROOT / "docs" / "over-tcp.md"
HEAD = """# Force release over TCP

This page shows the settling of the README's demo over TCP: with the real gateway, and
`controller/forcemesh.as` executed by the emulated controller. The tool presses with 30 N, then
force feedback brings the force to its set point (0 N; mode both: 10 N on a plate tilted 5 degrees),
with the gains of the documented rule. Settled means within 1 N and 0.1 N m for five seconds.
Least segment: the controller stops with E1117 if a motion that blends into the next one is planned
for less. Ahead: motions that it takes from the program beyond the present one. Pessimistic: the
worse interpretation of every question that the controller's manuals leave open, among them an
acceleration by time (0.2 s to the speed of any motion) and nothing slower than 1.2 mm/s.
Loop: iterations of the program per second during force feedback, by its
own counter in command 103; with host pc it iterates once per new pose. Sender: poses per second
from the controller. Run {how}; made by `{command}`.

| host, mode, stiffness | least segment, ahead | settling | overshoot | loop | sender |
|---|---|---:|---:|---:|---:|"""

RunCell = Callable[[CellConfig, ScenarioPlan], Trace]


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table."""

    host: Host
    mode: Mode
    stiffness_N_m: float
    least_segment_s: float
    motions_ahead: int
    pessimistic: bool


def in_lock_step(cell: CellConfig, plan: ScenarioPlan) -> Trace:
    """Run on the virtual clock: the same on every machine, to the last digit."""
    return play_virtual(cell, plan, lambda *_: None)


def in_processes(cell: CellConfig, plan: ScenarioPlan) -> Trace:
    """Run in real processes over a real socket."""
    return play_real(cell, plan, lambda *_: None, 0.0)


def cases() -> list[Case]:
    """Return every combination, the pessimistic controller last."""
    choices = product((False, True), LEAST_SEGMENTS_S, MOTIONS_AHEAD, HOSTS, MODES, STIFFNESSES_N_M)
    return [
        Case(host, mode, stiffness_N_m, least_s, ahead, pessimistic)
        for pessimistic, least_s, ahead, host, mode, stiffness_N_m in choices
    ]


def run(case: Case, run_cell: RunCell = in_lock_step) -> Result:
    """Run one case with the documented gain rule. Raises ScenarioError if the arm was stopped."""
    cell = demo_cell(
        CELL,
        DemoOverrides(
            tilt_deg=DEFAULT_TILT_DEG[case.mode],
            stiffness_N_m=case.stiffness_N_m,
            least_segment_s=case.least_segment_s,
            motions_ahead=case.motions_ahead,
            pessimistic=case.pessimistic,
        ),
    )
    plan = ScenarioPlan(
        mode=case.mode,
        host=case.host,
        setpoint_N=DEFAULT_SETPOINT_N[case.mode],
        settled_for_s=STAYS_S,
    )
    return measure(run_cell(cell, plan), plan, surface_of(cell), tune(cell).tau_s)


def row_of_real(case: Case) -> tuple[str, ...]:
    """Return the same from real processes."""
    return row(case, in_processes)


def row(case: Case, run_cell: RunCell = in_lock_step) -> tuple[str, ...]:
    """Return the table row of a case."""
    name = f"{case.host}, {case.mode}, {case.stiffness_N_m:g} N/m"
    controller = f"{case.least_segment_s * 1e3:g} ms, {case.motions_ahead}"
    controller += ", pessimistic" if case.pessimistic else ""
    try:
        result = run(case, run_cell)
    except ScenarioError as error:
        return name, controller, "stopped", str(error), "", ""
    settling = "not settled"
    if result.settling_s is not None:
        taus = result.settling_s / result.tau_s
        settling = f"{result.settling_s * 1e3:.0f} ms, {taus:.1f} tau"
    rates = [result.robot_numbers.get(key) for key in ("program_loop_hz", "sender_hz")]
    loop, sender = ("unknown" if rate is None else f"{rate:.0f} /s" for rate in rates)
    return name, controller, settling, f"{result.overshoot_pct:.1f} %", loop, sender


def page(rows: Iterable[tuple[str, ...]], *, real: bool) -> str:
    """Return the page of the documentation with every case."""
    how = "in real processes over a real socket" if real else "in lock step on the virtual clock"
    lines = [HEAD.format(how=how, command="make bench-tcp" + (" ARGS=--real" if real else ""))]
    lines += ["| " + " | ".join(cells) + " |" for cells in rows]
    return "\n".join(lines) + "\n"


def main(
    *,
    real: Annotated[bool, Option(help="Real processes and sockets; about half an hour.")] = False,
    write: Annotated[bool, Option(help="Write docs/over-tcp.md.")] = False,
) -> None:
    """Run every case and print, or write, the table."""
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()]
    with Progress(*columns, console=Console(stderr=True)) as bar, ProcessPoolExecutor() as pool:
        rows = map(row_of_real, cases()) if real else pool.map(row, cases())
        text = page(bar.track(rows, total=len(cases())), real=real)
    if write:
        PAGE.write_text(as_block_page("over-tcp", text, "make bench-tcp ARGS=--write"))
    else:
        Console().print(Markdown(text))


if __name__ == "__main__":
    run_typer(main)
