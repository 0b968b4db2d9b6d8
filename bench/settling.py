"""Settling and overshoot of the force release over stiffness, delay and mode, virtual clock."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import get_args

from bench.harness import CaseTable, Options, worst
from bench.results import ROOT, Row, Table, table
from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell, surface_of
from cli.demo.measures import Result
from cli.demo.measures import measure as measures_of
from cli.demo.scenario import ScenarioPlan, play_virtual
from forcemesh.messages import Mode
from tuning.gain_rule import tune

CELL = ROOT / "cells" / "demo.yaml"
STIFFNESSES_N_M = (5e3, 2e4, 1e5)
DELAYS_MS = (0, 10, 30)
MODES: tuple[Mode, ...] = get_args(Mode)
MEASURES = {"settling_ms": ".0f", "settling_tau": ".1f", "overshoot_pct": ".1f"}
CONTACT = {"mode": "", "stiffness_N_m": "g"}


@dataclass(frozen=True, slots=True)
class Case:
    """One release."""

    mode: Mode
    stiffness_N_m: float
    delay_ms: int


def row(case: Case) -> Row:
    """Release with the documented gain rule."""
    tilt_deg = DEFAULT_TILT_DEG[case.mode]
    trial = DemoOverrides(
        tilt_deg=tilt_deg, stiffness_N_m=case.stiffness_N_m, delay_s=case.delay_ms / 1e3
    )
    cell = demo_cell(CELL, trial)
    plan = ScenarioPlan(mode=case.mode, setpoint_N=DEFAULT_SETPOINT_N[case.mode])
    trace = play_virtual(cell, plan, lambda *_: None)
    return asdict(case) | settled(measures_of(trace, plan, surface_of(cell), tune(cell).tau_s))


def settled(result: Result) -> Row:
    """Return the measures of a release; without a settling time it has not settled."""
    s = result.settling_s
    return {
        "settling_ms": None if s is None else 1e3 * s,
        "settling_tau": None if s is None else s / result.tau_s,
        "overshoot_pct": result.overshoot_pct,
    }


CASES = [Case(*choice) for choice in product(MODES, STIFFNESSES_N_M, DELAYS_MS)]
ROWS = CaseTable({**CONTACT, "delay_ms": "g", **MEASURES}, CASES, row)


BY_CONTACT = {
    **CONTACT,
    **{f"settling_at_delay_{delay_ms}_ms": ".0f" for delay_ms in DELAYS_MS},
    "longest_settling_tau": ".1f",
    "largest_overshoot_pct": ".1f",
}


def measure(options: Options) -> dict[str, Table]:
    """Return every release, and a row for each contact."""
    rows = ROWS.measured(options)
    return {"by-contact": table(BY_CONTACT, by_contact(rows)), "rows": ROWS.stored(rows)}


def by_contact(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the settling of a contact with each delay, and the worst of them."""
    for mode, k in dict.fromkeys((each["mode"], each["stiffness_N_m"]) for each in rows):
        ours = [each for each in rows if (each["mode"], each["stiffness_N_m"]) == (mode, k)]
        yield {
            "mode": mode,
            "stiffness_N_m": k,
            **{f"settling_at_delay_{row['delay_ms']}_ms": row["settling_ms"] for row in ours},
            "longest_settling_tau": worst(each["settling_tau"] for each in ours),
            "largest_overshoot_pct": worst(each["overshoot_pct"] for each in ours),
        }
