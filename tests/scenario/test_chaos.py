"""Evaluation of fault injections: it detects every violation. `make chaos` injects the faults."""

from collections import Counter

import numpy as np
import pytest

from forcemesh.topics import ROLES
from tests.chaos.cases import KINDS, PHASES, TWO, Case, matrix, named
from tests.chaos.ground_truth import FlangePath
from tests.chaos.outcome import Journal, Outcome, OutcomeLimits, violations
from tests.chaos.witness import ROW, Witness

LIMITS = OutcomeLimits(command_s=0.1, watchdog_s=0.0, speed_m_s=0.25)
CASE = Case("sim", "regulator", "kill", "press", 0)
MS = 1_000_000


def held(**change: object) -> Outcome:
    """Return an outcome without violations, except for the changed values."""
    good = Outcome(CASE, last_accepted_s=0.1, still_s=0.2, causes=["stale"], status_shows=True)
    for name, value in change.items():
        setattr(good, name, value)
    return good


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"last_accepted_s": 0.151}, "151 ms after the fault"),
        ({"still_s": 0.351}, "only after 351 ms"),
        ({"still_s": None}, "did not come to a stand"),
        ({"stale": 1}, "1 stale commands"),
        ({"moved_m": 6e-4}, "moved 0.60 mm"),
        ({"provoked": ["move"]}, "move accepted"),
        ({"fastest_m_s": 0.32}, "jumped: 320 mm/s"),
        ({"causes": []}, "nothing named a cause"),
        ({"status_shows": False}, "status did not show"),
        ({"recovered": False, "note": "it could not be armed"}, "could not be armed"),
        ({"continued": True}, "the cell went on"),
    ],
)
def test_every_violated_bound_is_reported(change, message):
    """One number outside its bound makes exactly one message; none makes none."""
    assert violations(held(), LIMITS) == []
    found = violations(held(**change), LIMITS)
    assert len(found) == 1
    assert message in found[0]


def test_the_matrix_hits_every_service_with_every_kind():
    """Each service and kind as often as requested; six each cover both cells in all phases."""
    cases = matrix(6, seed=3)
    assert set(Counter((case.role, case.kind) for case in cases).values()) == {6}
    assert {(case.role, case.kind) for case in cases} == {(r, k) for r in ROLES for k in KINDS}
    assert len(set(cases)) == len(cases)
    hub = {(case.cell, case.phase) for case in cases if case.role == "hub" and case.kind == "kill"}
    assert hub == {(cell, phase) for cell in ("sim", "tcp") for phase in PHASES}
    assert {case.cell for case in cases if case.role == "sensor"} == {"tcp"}
    assert all(named(case.name) == (case.role, case.kind, case.phase) for case in cases)


def test_a_double_fault_hits_two_processes_and_never_robot_or_arm_second():
    """By the seed, the second one is another process; the measured processes are not hit."""
    for case in matrix(6, seed=1):
        assert bool(case.second_role) == (case.kind in TWO)
        assert case.second_role not in (case.role, "robot", "sensor")
        frozen_s = {"freeze-0.1": 0.1, "freeze-5": 5.0}.get(case.kind, 1.0)
        assert case.frozen_s == (frozen_s if "freeze" in case.kind or "frozen" in case.kind else 0)


def path(*speeds_m_s: float) -> FlangePath:
    """Return a flange path with one speed for each millisecond, starting at the origin."""
    count = len(speeds_m_s)
    return FlangePath(np.arange(count) * MS, np.zeros((count, 3)), np.array(speeds_m_s))


def test_the_flange_stands_when_it_is_slow_for_a_tenth_of_a_second():
    """A moment of rest during motion is none; rest that lasts begins with its first moment."""
    pause = [0.1] * 20 + [0.0] * 50 + [0.1] * 20
    assert path(*pause).still_since_ns() is None
    assert path(*pause, *[0.0] * 200).still_since_ns() == 90 * MS
    assert path(*[0.0] * 200).still_since_ns() == 0


def test_a_window_counts_the_stalls_that_overlap_it(tmp_path):
    """Late from 100 to 130 ms: it counts within, across an edge, and nowhere else."""
    noted = tmp_path / "noted"
    noted.write_bytes(ROW.pack(130 * MS, 30 * MS) + ROW.pack(206 * MS, 6 * MS))
    worst_s = Witness([noted]).worst_s
    assert worst_s(90 * MS, 210 * MS) == pytest.approx(0.030)
    assert worst_s(120 * MS, 150 * MS) == pytest.approx(0.030)
    assert worst_s(131 * MS, 210 * MS) == pytest.approx(0.006)
    assert worst_s(140 * MS, 190 * MS) == 0.0


def test_an_interrupted_run_continues_with_the_cases_left(tmp_path):
    """The recorded outcomes are restored number by number; only the other cases are still left."""
    path = tmp_path / "out" / "journal.jsonl"
    first, second = matrix(1, 0)[:2]
    outcome = held(case=first, moved_m=1e-4, note="words")
    before = Journal(path)
    before.repeated("it moved with 1.0 mm/s only")
    before.tried(outcome)

    after = Journal(path)
    assert after.outcomes == [outcome]
    assert after.spoilt == ["it moved with 1.0 mm/s only"]
    assert after.left([first, second]) == [second]
