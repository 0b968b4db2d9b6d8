"""Settling and overshoot of the force release over stiffness, delay and mode, virtual clock."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal, get_args

from rich.table import Table

from bench.tables import as_markdown, on_screen
from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell, surface_of
from cli.demo.measures import Result, measure
from cli.demo.scenario import ScenarioPlan, play_virtual
from forcemesh.messages import Mode
from tools.figures import replace_block
from tuning.gain_rule import tune

ROOT = Path(__file__).resolve().parent.parent
CELL = ROOT / "cells" / "demo.yaml"
STIFFNESSES_N_M = (5e3, 2e4, 1e5)
DELAYS_MS = (0, 10, 30)
MODES: tuple[Literal["position", "orientation", "both"], ...] = get_args(Mode)


@dataclass(frozen=True, slots=True)
class Case:
    """One cell of the table."""

    mode: Mode
    stiffness_N_m: float
    delay_ms: int


def run(case: Case) -> Result:
    """Run one case with the documented gain rule."""
    cell = demo_cell(
        CELL,
        DemoOverrides(
            tilt_deg=DEFAULT_TILT_DEG[case.mode],
            stiffness_N_m=case.stiffness_N_m,
            delay_s=case.delay_ms / 1e3,
        ),
    )
    plan = ScenarioPlan(mode=case.mode, setpoint_N=DEFAULT_SETPOINT_N[case.mode])
    trace = play_virtual(cell, plan, lambda *_: None)
    return measure(trace, plan, surface_of(cell), tune(cell).tau_s)


def results() -> dict[Case, Result]:
    """Run every case."""
    cases = [Case(*choice) for choice in product(MODES, STIFFNESSES_N_M, DELAYS_MS)]
    with ProcessPoolExecutor() as pool:
        return dict(zip(cases, pool.map(run, cases), strict=True))


def rows(found: dict[Case, Result], modes: Sequence[Mode] = MODES) -> list[list[str]]:
    """Return settling [ms], in tau, and overshoot for every case, a row for mode and stiffness."""
    return [
        [
            f"{mode}, {stiffness:.0f} N/m",
            *(_cell(found[Case(mode, stiffness, delay_ms)]) for delay_ms in DELAYS_MS),
        ]
        for mode, stiffness in product(modes, STIFFNESSES_N_M)
    ]


HEAD = ["settling time, in tau, overshoot", *(f"delay {delay_ms} ms" for delay_ms in DELAYS_MS)]


def table() -> Table:
    """Measure, and return the table for the terminal."""
    return on_screen("release from 30 N", HEAD, rows(results()))


def write() -> None:
    """Measure and write the table into docs/demo.md."""
    text = as_markdown(HEAD, rows(results()))
    replace_block(ROOT / "docs" / "demo.md", "settling", text, 'make bench ARGS="settling --write"')


def _cell(result: Result) -> str:
    if result.settling_s is None:
        return "not settled"
    taus = result.settling_s / result.tau_s
    return f"{result.settling_s * 1e3:.0f} ms, {taus:.1f} tau, {result.overshoot_pct:.1f} %"
