"""Table of what a slow loop bears: made from the rows, and used by arming."""

import pytest

from bench.over_tcp import CASES, CONTROLLERS, STIFFNESSES_N_M, bears, failed
from bench.results import Row, read
from control.measured_range import SEGMENTS


def row(case: Row, **changes: object) -> Row:
    """Return a row with these numbers; the approach speed is 10 mm/s at 5e3 N/m."""
    approach_m_s = 50.0 / case["stiffness_N_m"]
    good = {"approach_m_s": approach_m_s, "outcome": "settled", "overshoot_pct": 3.0}
    return {**case, **good, **changes}


def test_where_every_row_settles_the_stiffest_contact_is_stated() -> None:
    """One line for each least segment, the shortest first."""
    lines = [[*line.values()] for line in bears([row(case) for case in CASES])]
    assert [line[0] for line in lines] == [16.0, 20.0, 30.0, 45.0, 60.0]
    stiffest = max(STIFFNESSES_N_M)
    assert {tuple(line[1:]) for line in lines} == {(stiffest, 3.0, 5e4 / stiffest, 50)}


@pytest.mark.parametrize(
    "changes",
    [{"outcome": "not settled"}, {"overshoot_pct": 10.1}, {"outcome": "stopped: E1117"}],
)
def test_one_row_that_fails_excludes_its_stiffness_and_every_stiffer_one(changes) -> None:
    """Only for its least segment, whichever host, mode and controller it is."""
    broken = {
        "host": "controller", "mode": "both", "stiffness_N_m": STIFFNESSES_N_M[1],
        "least_segment_ms": 45.0, "motions_ahead": 1, "controller": "pessimistic",
    }  # fmt: skip
    assert broken in CASES
    rows = [row(case, **(changes if case == broken else {})) for case in CASES]
    stiffest = {line["least_segment_ms"]: line["stiffest_contact_N_m"] for line in bears(rows)}
    assert stiffest.pop(45.0) == STIFFNESSES_N_M[0]
    assert set(stiffest.values()) == {max(STIFFNESSES_N_M)}
    (fails,) = failed(rows)
    assert (fails["rows"], fails["stiffness_N_m"]) == (1, STIFFNESSES_N_M[1])


def test_a_least_segment_with_which_nothing_settles_is_stated_as_such() -> None:
    """No number stands in its line."""
    lines = bears([row(case, outcome="not settled") for case in CASES])
    assert {tuple(line) for line in lines} == {("least_segment_ms",)}


def test_the_table_that_arming_uses_is_that_of_the_result() -> None:
    """Least segment, stiffest contact and rise of the force, as measured."""
    measured = [
        (each["least_segment_ms"] / 1e3, each["stiffest_contact_N_m"], each["force_rises_by_N_s"])
        for each in read("over-tcp").tables["bears"].records
    ]
    assert measured == [tuple(row) for row in SEGMENTS]
    assert len(SEGMENTS) == len({least_ms for least_ms, _ in CONTROLLERS})
