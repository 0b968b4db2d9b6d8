"""Force release over gateway, TCP and the program in the emulated controller: every combination.

The emulated controller stops with E1117 at a motion that blends into the next one and is planned
for less than the least segment; `pessimistic` selects the worse interpretation of every open
question, among them an acceleration by time.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from math import ceil, inf, nan
from pathlib import Path
from typing import Annotated, get_args

from rich.console import Console
from rich.markdown import Markdown
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from typer import Option
from typer import run as run_typer

from bench.settling import MODES
from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell, surface_of
from cli.demo.measures import Result, measure
from cli.demo.scenario import ScenarioError, ScenarioPlan, Trace, play_real, play_virtual
from common.config.cell import CellConfig
from forcemesh.messages import Host, Mode
from tools.figures import as_block_page
from tuning.gain_rule import tune

HOSTS: tuple[Host, ...] = get_args(Host)
CONTROLLERS = (  # least segment [s], motions ahead
    (0.030, 1), (0.030, 3), (0.016, 1), (0.016, 3), (0.020, 1), (0.045, 1), (0.060, 1),
)  # fmt: skip
STIFFNESSES_N_M = (5e3, 2e4, 3e4, 1e5)
OVERSHOOT_MOST_PCT = 10.0  # of a contact that a controller bears
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

## What a slow loop bears

The stiffest of these contacts up to which every row of a least segment settles and overshoots by at
most {most:g} %, the largest overshoot of these rows, and the approach speed with the plain
controller. Arming refuses a stiffer contact and a faster approach (their product is the rate at
which the force rises) with the numbers of this table.

{bears}

## All rows

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


@dataclass(frozen=True, slots=True)
class Outcome:
    """A case and what happened; no result: the arm was stopped."""

    case: Case
    approach_m_s: float
    result: Result | None = None
    stopped: str = ""

    @property
    def overshoot_pct(self) -> float:
        """Overshoot; not a number where the arm was stopped."""
        return nan if self.result is None else self.result.overshoot_pct

    @property
    def is_borne(self) -> bool:
        """Whether the force settled without more overshoot than a controller may have."""
        result = self.result
        if result is None or result.settling_s is None:
            return False
        return self.overshoot_pct <= OVERSHOOT_MOST_PCT


def cases() -> list[Case]:
    """Return every combination, the pessimistic controller last."""
    choices = product((False, True), CONTROLLERS, HOSTS, MODES, STIFFNESSES_N_M)
    return [
        Case(host, mode, stiffness_N_m, *controller, pessimistic)
        for pessimistic, controller, host, mode, stiffness_N_m in choices
    ]


def cell_of(case: Case) -> CellConfig:
    """Return the cell of a case."""
    return demo_cell(
        CELL,
        DemoOverrides(
            tilt_deg=DEFAULT_TILT_DEG[case.mode],
            stiffness_N_m=case.stiffness_N_m,
            least_segment_s=case.least_segment_s,
            motions_ahead=case.motions_ahead,
            pessimistic=case.pessimistic,
        ),
    )


def run(case: Case, run_cell: RunCell = in_lock_step) -> Outcome:
    """Run one case with the documented gain rule."""
    cell = cell_of(case)
    plan = ScenarioPlan(
        mode=case.mode,
        host=case.host,
        setpoint_N=DEFAULT_SETPOINT_N[case.mode],
        settled_for_s=STAYS_S,
    )
    try:
        trace = run_cell(cell, plan)
    except ScenarioError as error:
        return Outcome(case, cell.force.approach_m_s, stopped=str(error))
    result = measure(trace, plan, surface_of(cell), tune(cell).tau_s)
    return Outcome(case, cell.force.approach_m_s, result)


def run_real(case: Case) -> Outcome:
    """Run one case in real processes."""
    return run(case, in_processes)


def row(outcome: Outcome) -> tuple[str, ...]:
    """Return the table row of a case."""
    case, result = outcome.case, outcome.result
    name = f"{case.host}, {case.mode}, {case.stiffness_N_m:g} N/m"
    controller = f"{case.least_segment_s * 1e3:g} ms, {case.motions_ahead}"
    controller += ", pessimistic" if case.pessimistic else ""
    if result is None:
        return name, controller, "stopped", outcome.stopped, "", ""
    settling = "not settled"
    if result.settling_s is not None:
        taus = result.settling_s / result.tau_s
        settling = f"{result.settling_s * 1e3:.0f} ms, {taus:.1f} tau"
    rates = [result.robot_numbers.get(key) for key in ("program_loop_hz", "sender_hz")]
    loop, sender = ("unknown" if rate is None else f"{rate:.0f} /s" for rate in rates)
    return name, controller, settling, f"{result.overshoot_pct:.1f} %", loop, sender


def bears(outcomes: Sequence[Outcome]) -> str:
    """Return the table of the stiffest contact and the approach speed by least segment."""
    lines = [
        "| least segment | stiffest contact | overshoot up to it | approach | the force rises by |",
        "|---:|---:|---:|---:|---:|",
    ]
    for least_s in sorted({least_s for least_s, _ in CONTROLLERS}):
        ours = [each for each in outcomes if each.case.least_segment_s == least_s]
        failed_N_m = {each.case.stiffness_N_m for each in ours if not each.is_borne}
        borne_N_m = [k for k in STIFFNESSES_N_M if k < min(failed_N_m, default=inf)]
        if not borne_N_m:
            lines.append(f"| {least_s * 1e3:g} ms | none | | | |")
            continue
        k = max(borne_N_m)
        at_stiffest = [each for each in ours if each.case.stiffness_N_m == k]
        approach_m_s = min(each.approach_m_s for each in at_stiffest if not each.case.pessimistic)
        most_pct = max(each.overshoot_pct for each in ours if each.case.stiffness_N_m <= k)
        lines.append(
            f"| {least_s * 1e3:g} ms | {k:g} N/m | {most_pct:.1f} % "
            f"| {approach_m_s * 1e3:.2f} mm/s | {ceil(k * approach_m_s)} N/s |"
        )
    return "\n".join(lines)


def page(outcomes: Sequence[Outcome], *, real: bool) -> str:
    """Return the page of the documentation with every case."""
    how = "in real processes over a real socket" if real else "in lock step on the virtual clock"
    command = "make bench-tcp" + (" ARGS=--real" if real else "")
    table = bears(outcomes)
    lines = [HEAD.format(how=how, command=command, most=OVERSHOOT_MOST_PCT, bears=table)]
    lines += ["| " + " | ".join(row(outcome)) + " |" for outcome in outcomes]
    return "\n".join(lines) + "\n"


def main(
    *,
    real: Annotated[bool, Option(help="Real processes and sockets; about half an hour.")] = False,
    write: Annotated[bool, Option(help="Write docs/over-tcp.md.")] = False,
) -> None:
    """Run every case and print, or write, the table."""
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()]
    with Progress(*columns, console=Console(stderr=True)) as bar, ProcessPoolExecutor() as pool:
        outcomes = map(run_real, cases()) if real else pool.map(run, cases())
        text = page(list(bar.track(outcomes, total=len(cases()))), real=real)
    if write:
        PAGE.write_text(as_block_page("over-tcp", text, "make bench-tcp ARGS=--write"))
    else:
        Console().print(Markdown(text))


if __name__ == "__main__":
    run_typer(main)
