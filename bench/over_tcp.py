"""Force release over gateway, TCP and the program in the emulated controller: every combination.

The emulated controller stops with E1117 at a motion that blends into the next one and is planned
for less than the least segment; `pessimistic` selects the worse interpretation of every open
question, among them an acceleration by time. All on the virtual clock, in lock step.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from math import ceil, inf
from statistics import median
from typing import get_args

from bench.harness import CaseTable, Options, worst
from bench.results import ROOT, Row, Table, table
from bench.settling import MEASURES, MODES, settled
from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell, surface_of
from cli.demo.measures import measure as measures_of
from cli.demo.scenario import ScenarioError, ScenarioPlan, play_virtual
from common.config.cell import CellConfig
from forcemesh.messages import Host, Mode
from tuning.gain_rule import tune

HOSTS: tuple[Host, ...] = get_args(Host)
CONTROLLERS = (  # least segment [ms], motions ahead
    (30.0, 1), (30.0, 3), (16.0, 1), (16.0, 3), (20.0, 1), (45.0, 1), (60.0, 1),
)  # fmt: skip
STIFFNESSES_N_M = (5e3, 2e4, 3e4, 1e5)
OVERSHOOT_MOST_PCT = 10.0  # of a contact that a controller bears
STAYS_S = 5.0  # longer than the window in which the gateway counts
CELL = ROOT / "cells" / "demo-tcp.yaml"

ROW = {
    "host": "", "mode": "", "stiffness_N_m": "g", "least_segment_ms": "g", "motions_ahead": "d",
    "controller": "", "outcome": "", **MEASURES, "loop_hz": ".0f", "sender_hz": ".0f",
}  # fmt: skip
BEARS = {
    "least_segment_ms": "g", "stiffest_contact_N_m": "g", "overshoot_up_to_it_pct": ".1f",
    "approach_mm_s": ".2f", "force_rises_by_N_s": "d",
}  # fmt: skip
SUMMARY = {
    "host": "", "mode": "", "rows": "d", "settled": "d", "median_settling_tau": ".1f",
    "longest_settling_tau": ".1f", "largest_overshoot_pct": ".1f",
}  # fmt: skip
FAILED = {
    "stiffness_N_m": "g", "least_segment_ms": "g", "controller": "", "outcome": "", "rows": "d",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Case:
    """One release."""

    host: Host
    mode: Mode
    stiffness_N_m: float
    least_segment_ms: float
    motions_ahead: int
    controller: str  # default or pessimistic


def row(case: Case) -> Row:
    """Release with the documented gain rule."""
    trial = DemoOverrides(
        tilt_deg=DEFAULT_TILT_DEG[case.mode],
        stiffness_N_m=case.stiffness_N_m,
        least_segment_s=case.least_segment_ms / 1e3,
        motions_ahead=case.motions_ahead,
        pessimistic=case.controller == "pessimistic",
    )
    cell = demo_cell(CELL, trial)
    plan = ScenarioPlan(
        mode=case.mode,
        host=case.host,
        setpoint_N=DEFAULT_SETPOINT_N[case.mode],
        settled_for_s=STAYS_S,
    )
    return {**asdict(case), "approach_m_s": cell.force.approach_m_s, **released(cell, plan)}


def released(cell: CellConfig, plan: ScenarioPlan) -> Row:
    """Run in lock step, the same on every machine to the last digit; return the measures."""
    try:
        trace = play_virtual(cell, plan, lambda *_: None)
    except ScenarioError as error:
        return {"outcome": f"stopped: {error}"}
    result = measures_of(trace, plan, surface_of(cell), tune(cell).tau_s)
    return {
        **settled(result),
        "outcome": "not settled" if result.settling_s is None else "settled",
        "loop_hz": result.robot_numbers.get("program_loop_hz"),
        "sender_hz": result.robot_numbers.get("sender_hz"),
    }


CASES = [
    Case(host, mode, stiffness_N_m, *segments, controller)
    for controller, segments, host, mode, stiffness_N_m in product(
        ("default", "pessimistic"), CONTROLLERS, HOSTS, MODES, STIFFNESSES_N_M
    )
]
ROWS = CaseTable(ROW, CASES, row)


def measure(options: Options) -> dict[str, Table]:
    """Return every row, what a slow loop bears, and the worst."""
    rows = ROWS.measured(options)
    return {
        "bears": table(BEARS, bears(rows)),
        "summary": table(SUMMARY, summary(rows)),
        "failed": table(FAILED, failed(rows)),
        "rows": ROWS.stored(rows),
    }


def is_borne(each: Row) -> bool:
    """Whether the force settled without more overshoot than a controller may have."""
    return bool(each["outcome"] == "settled" and each["overshoot_pct"] <= OVERSHOOT_MOST_PCT)


def bears(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the stiffest contact, up to which every row is borne, by least segment."""
    for least_ms in sorted({each["least_segment_ms"] for each in rows}):
        ours = [each for each in rows if each["least_segment_ms"] == least_ms]
        failed_N_m = {each["stiffness_N_m"] for each in ours if not is_borne(each)}
        borne_N_m = [k for k in STIFFNESSES_N_M if k < min(failed_N_m, default=inf)]
        if not borne_N_m:
            yield {"least_segment_ms": least_ms}
            continue
        k = max(borne_N_m)
        approach_m_s = min(
            each["approach_m_s"]
            for each in ours
            if each["stiffness_N_m"] == k and each["controller"] == "default"
        )
        yield {
            "least_segment_ms": least_ms,
            "stiffest_contact_N_m": k,
            "overshoot_up_to_it_pct": worst(
                each["overshoot_pct"] for each in ours if each["stiffness_N_m"] <= k
            ),
            "approach_mm_s": 1e3 * approach_m_s,
            "force_rises_by_N_s": ceil(k * approach_m_s),
        }


def summary(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the median and the worst of the rows of a host and mode that settled."""
    for host, mode in product(HOSTS, MODES):
        ours = [each for each in rows if (each["host"], each["mode"]) == (host, mode)]
        good = [each for each in ours if each["outcome"] == "settled"]
        yield {
            "host": host,
            "mode": mode,
            "rows": len(ours),
            "settled": len(good),
            "median_settling_tau": median(each["settling_tau"] for each in good),
            "longest_settling_tau": max(each["settling_tau"] for each in good),
            "largest_overshoot_pct": max(each["overshoot_pct"] for each in good),
        }


def failed(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield how many rows did not settle, or overshot by too much, and where."""
    names = [name for name in FAILED if name != "rows"]
    bad = [{**r, "outcome": r["outcome"].rpartition(":")[0] or r["outcome"]}
           for r in rows if not is_borne(r)]  # fmt: skip
    places = Counter(tuple(each[name] for name in names) for each in bad)
    for place, count in places.items():
        yield {**dict(zip(names, place, strict=True)), "rows": count}
