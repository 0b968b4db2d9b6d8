"""Table of what a slow loop bears: made from the rows, and used by arming."""

import pytest

from bench import over_tcp
from bench.over_tcp import CONTROLLERS, STIFFNESSES_N_M, Case, Outcome, bears, cases
from cli.demo.measures import Result
from tuning.measured_range import SEGMENTS

HEAD_LINES = 2


def outcome(case: Case, overshoot_pct: float = 3.0, settling_s: float | None = 0.4) -> Outcome:
    """Return a row with these numbers; the approach speed is 10 mm/s at 5e3 N/m."""
    result = Result(
        settled=settling_s is not None, peak_force_N=30.0, settling_s=settling_s,
        overshoot_pct=overshoot_pct, final_force_N=0.0, final_torque_Nm=0.0, misalignment_deg=0.0,
        lift_off_mm=0.0, tau_s=0.1, chain_latency_us_p50=None, chain_latency_us_p99=None,
        hops_us={}, robot_numbers={},
    )  # fmt: skip
    return Outcome(case, 50.0 / case.stiffness_N_m, result)


def rows(outcomes: list[Outcome]) -> list[list[str]]:
    """Return the cells of the table."""
    lines = bears(outcomes).splitlines()[HEAD_LINES:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_where_every_row_settles_the_stiffest_contact_is_stated() -> None:
    """One line for each least segment, the shortest first."""
    table = rows([outcome(case) for case in cases()])
    assert [line[0] for line in table] == ["16 ms", "20 ms", "30 ms", "45 ms", "60 ms"]
    stiffest = max(STIFFNESSES_N_M)
    assert {tuple(line[1:]) for line in table} == {
        (f"{stiffest:g} N/m", "3.0 %", f"{5e4 / stiffest:.2f} mm/s", "50 N/s")
    }


@pytest.mark.parametrize("why", ["not settled", "overshoots", "stopped"])
def test_one_row_that_fails_excludes_its_stiffness_and_every_stiffer_one(why: str) -> None:
    """Only for its least segment, whichever host, mode and controller it is."""
    broken = next(
        case for case in cases()
        if case.least_segment_s == 0.045 and case.stiffness_N_m == STIFFNESSES_N_M[1]
        and case.host == "controller" and case.mode == "both" and case.pessimistic
    )  # fmt: skip
    failed = {
        "not settled": outcome(broken, settling_s=None),
        "overshoots": outcome(broken, overshoot_pct=10.1),
        "stopped": Outcome(broken, 0.01, stopped="the arm holds: E1117"),
    }[why]
    table = rows([failed if case == broken else outcome(case) for case in cases()])
    assert [line[1] for line in table if line[0] == "45 ms"] == [f"{STIFFNESSES_N_M[0]:g} N/m"]
    assert {line[1] for line in table if line[0] != "45 ms"} == {f"{max(STIFFNESSES_N_M):g} N/m"}
    assert ("E1117" in over_tcp.row(failed)[3]) == (why == "stopped")


def test_a_least_segment_with_which_nothing_settles_is_stated_as_such() -> None:
    """No number stands in its line."""
    table = rows([outcome(case, settling_s=None) for case in cases()])
    assert {tuple(line[1:]) for line in table} == {("none", "", "", "")}


def test_the_table_that_arming_uses_is_that_of_the_page() -> None:
    """Least segment, stiffest contact and rise of the force, as measured."""
    text = over_tcp.PAGE.read_text(encoding="utf-8").partition("## What a slow loop bears")[2]
    lines = [line for line in text.partition("## All rows")[0].splitlines() if " ms |" in line]
    stated = []
    for line in lines:
        segment, stiffest, _, _, rate = (cell.split()[0] for cell in line.strip("| ").split("|"))
        stated.append((float(segment) / 1e3, float(stiffest), float(rate)))
    assert stated == [tuple(row) for row in SEGMENTS]
    assert len(SEGMENTS) == len({least_s for least_s, _ in CONTROLLERS})
