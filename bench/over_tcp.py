"""Force release over gateway, TCP and the program in the emulated controller: every combination.

The emulated controller stops with E1117 at a motion that blends into the next one and is planned
for less than the least segment; `pessimistic` selects the worse interpretation of every open
question, among them an acceleration by time. All on the virtual clock, in lock step.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from math import ceil, inf
from statistics import median
from typing import get_args

from bench.harness import CaseTable, Options, Tables, grouped, worst
from bench.results import ROOT, Row
from bench.settling import MODES, released
from cli.demo.cell import DEFAULT_SETPOINT_N, DEFAULT_TILT_DEG, DemoOverrides, demo_cell
from cli.demo.scenario import ScenarioPlan
from forcemesh.messages import Host, Mode

HOSTS: tuple[Host, ...] = get_args(Host)
CONTROLLERS = (  # least segment [ms], motions ahead
    (30.0, 1), (30.0, 3), (16.0, 1), (16.0, 3), (20.0, 1), (45.0, 1), (60.0, 1),
)  # fmt: skip
STIFFNESSES_N_M = (5e3, 2e4, 3e4, 1e5)
OVERSHOOT_MOST_PCT = 10.0  # of a contact that a controller bears
STAYS_S = 5.0  # longer than the window in which the gateway counts
CELL = ROOT / "cells" / "demo-tcp.yaml"
PLACE = ("stiffness_N_m", "least_segment_ms", "controller", "outcome")


def row(case: Row) -> Row:
    """Release with the documented gain rule."""
    mode: Mode = case["mode"]
    trial = DemoOverrides(
        tilt_deg=DEFAULT_TILT_DEG[mode],
        stiffness_N_m=case["stiffness_N_m"],
        least_segment_s=case["least_segment_ms"] / 1e3,
        motions_ahead=case["motions_ahead"],
        pessimistic=case["controller"] == "pessimistic",
    )
    cell, setpoint_N = demo_cell(CELL, trial), DEFAULT_SETPOINT_N[mode]
    plan = ScenarioPlan(mode, case["host"], setpoint_N=setpoint_N, settled_for_s=STAYS_S)
    return {**case, "approach_m_s": cell.force.approach_m_s, **released(cell, plan)}


CASES: list[Row] = [
    {
        "host": host,
        "mode": mode,
        "stiffness_N_m": stiffness_N_m,
        "least_segment_ms": least_ms,
        "motions_ahead": ahead,
        "controller": controller,
    }
    for controller, (least_ms, ahead), host, mode, stiffness_N_m in product(
        ("default", "pessimistic"), CONTROLLERS, HOSTS, MODES, STIFFNESSES_N_M
    )
]
ROWS = CaseTable(CASES, row)


def measure(options: Options) -> Tables:
    """Return every row, what a slow loop bears, and the worst."""
    rows = ROWS.measured(options)
    return {
        "bears": bears(rows),
        "summary": summary(rows),
        "failed": failed(rows),
        "rows": rows,
    }


def is_borne(each: Row) -> bool:
    """Whether the force settled without more overshoot than a controller may have."""
    return bool(each["outcome"] == "settled" and each["overshoot_pct"] <= OVERSHOOT_MOST_PCT)


def bears(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the stiffest contact, up to which every row is borne, by least segment."""
    by_segment = sorted(rows, key=lambda each: float(each["least_segment_ms"]))
    for segment, ours in grouped(by_segment, "least_segment_ms"):
        failed_N_m = {each["stiffness_N_m"] for each in ours if not is_borne(each)}
        borne_N_m = [k for k in STIFFNESSES_N_M if k < min(failed_N_m, default=inf)]
        if not borne_N_m:
            yield segment
            continue
        k = max(borne_N_m)
        approach_m_s = min(
            each["approach_m_s"]
            for each in ours
            if each["stiffness_N_m"] == k and each["controller"] == "default"
        )
        yield {
            **segment,
            "stiffest_contact_N_m": k,
            "overshoot_up_to_it_pct": worst(
                each["overshoot_pct"] for each in ours if each["stiffness_N_m"] <= k
            ),
            "approach_mm_s": 1e3 * approach_m_s,
            "force_rises_by_N_s": ceil(k * approach_m_s),
        }


def summary(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the median and the worst of the rows of a host and mode that settled."""
    for place, ours in grouped(rows, "host", "mode"):
        good = [each for each in ours if each["outcome"] == "settled"]
        yield {
            **place,
            "rows": len(ours),
            "settled": len(good),
            "median_settling_tau": median(each["settling_tau"] for each in good),
            "longest_settling_tau": worst(each["settling_tau"] for each in good),
            "largest_overshoot_pct": worst(each["overshoot_pct"] for each in good),
        }


def failed(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield how many rows did not settle, or overshot by too much, and where."""
    bad = [{**r, "outcome": r["outcome"].rpartition(":")[0] or r["outcome"]}
           for r in rows if not is_borne(r)]  # fmt: skip
    for place, ours in grouped(bad, *PLACE):
        yield {**place, "rows": len(ours)}
