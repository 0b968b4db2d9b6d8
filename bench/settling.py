"""Settling and overshoot of the force release over stiffness, delay and mode, virtual clock."""

from collections.abc import Iterator, Sequence
from typing import get_args

from bench.harness import CaseTable, Options, Tables, grid, grouped, worst
from bench.results import ROOT, Row
from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell, surface_of
from cli.demo.measures import measure as measures_of
from cli.demo.scenario import ScenarioError, ScenarioPlan, play_virtual
from common.config.cell import CellConfig
from control.gain_rule import tune
from forcemesh.messages import Mode

CELL = ROOT / "cells" / "demo.yaml"
DELAYS_MS = (0, 10, 30)
MODES: tuple[Mode, ...] = get_args(Mode)


def row(case: Row) -> Row:
    """Release with the documented gain rule."""
    mode: Mode = case["mode"]
    trial = DemoOverrides(
        tilt_deg=DEFAULT_TILT_DEG[mode],
        stiffness_N_m=case["stiffness_N_m"],
        delay_s=case["delay_ms"] / 1e3,
    )
    plan = ScenarioPlan(mode=mode, setpoint_N=DEFAULT_SETPOINT_N[mode])
    return {**case, **released(demo_cell(CELL, trial), plan)}


def released(cell: CellConfig, plan: ScenarioPlan) -> Row:
    """Run in lock step, the same on every machine to the last digit; return the measures."""
    try:
        trace = play_virtual(cell, plan, lambda *_: None)
    except ScenarioError as error:
        return {"outcome": f"stopped: {error}"}
    result = measures_of(trace, plan, surface_of(cell), tune(cell).tau_s)
    settling_s = result.settling_s
    return {
        "outcome": "not settled" if settling_s is None else "settled",
        "settling_ms": None if settling_s is None else 1e3 * settling_s,
        "settling_tau": None if settling_s is None else settling_s / result.tau_s,
        "overshoot_pct": result.overshoot_pct,
        "loop_hz": result.robot_numbers.get("program_loop_hz"),
        "sender_hz": result.robot_numbers.get("sender_hz"),
    }


ROWS = CaseTable(
    grid(mode=MODES, stiffness_N_m=(5e3, 2e4, 1e5), delay_ms=DELAYS_MS),
    row,
)


def measure(options: Options) -> Tables:
    """Return every release, and a row for each contact."""
    rows = ROWS.measured(options)
    return {"by-contact": by_contact(rows), "rows": rows}


def by_contact(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the settling of a contact with each delay, and the worst of them."""
    for contact, ours in grouped(rows, "mode", "stiffness_N_m"):
        yield {
            **contact,
            **{f"settling_at_delay_{row['delay_ms']}_ms": row["settling_ms"] for row in ours},
            "longest_settling_tau": worst(each["settling_tau"] for each in ours),
            "largest_overshoot_pct": worst(each["overshoot_pct"] for each in ours),
        }
