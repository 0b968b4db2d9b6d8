"""Tasks per axis in the benchmark: what a pilot does with a task, and what is required."""

from math import inf

import numpy as np
import pytest

from bench.force import axes
from bench.force.axes import pilot_of, task_change, three_axes
from bench.results import Row


def case_of(law: str) -> Row:
    """Return a law on 2e4 N/m in a fast loop."""
    return {"law": law, "stiffness_N_m": 2e4, "loop_hz": 250.0}


@pytest.mark.parametrize("law", ["adaptive", "admittance, known k"])
def test_set_points_along_three_coupled_axes_are_reached_at_once(law: str) -> None:
    """Both kinds of pilot, and the rotation that is held stays."""
    row = three_axes(pilot_of(case_of(law), 1))
    assert row["settling_s"] < 1.0
    assert row["steady_error_N"] < 0.1
    assert row["held_deg"] < 0.2


@pytest.mark.parametrize("law", ["adaptive", "FDCC-like, known k"])
def test_a_change_of_frame_and_axes_has_no_bump(law: str, monkeypatch) -> None:
    """The frame changes at the present loads; the axis that is held then does not move."""
    monkeypatch.setattr(axes, "SETTLES_S", 2.0)
    row = task_change(pilot_of(case_of(law), 0))
    assert row["bump_N"] < 1.0
    assert row["held_mm"] < 0.2
    assert row["steady_error_N"] < 0.1


def test_the_set_points_are_in_the_frame_and_with_the_sign_of_the_task() -> None:
    """The tool exerts +5, -4 and +10 N along base axes, after the ramp."""
    pilot = pilot_of(case_of("plain, known k"), 0)
    pilot.start(axes.THREE)
    assert max(map(abs, pilot.task.force_N)) < 0.5  # from no load
    trace = pilot.rig.run(pilot, 2.0)
    exerted_N = -np.mean(trace.force_N[-50:], axis=0)
    assert exerted_N == pytest.approx([5.0, -4.0, 10.0], abs=0.5)


def test_the_worst_counts_and_what_does_not_settle_has_no_number() -> None:
    """One row that is worse than the others; of all laws it is ours that has requirements."""
    names = ("settling_s", "steady_error_N", "held_deg", "held_mm", "bump_N")
    good = [{**case, **dict.fromkeys(names, 0.01)} for case in axes.CASES]
    rows = {scene: [*good] for scene in axes.TABLES}
    assert all(each["met"] for each in axes.requirements(rows))
    bad = {"law": "adaptive", "stiffness_N_m": 2e4, "loop_hz": 250.0, "settling_s": None}
    rows["change-of-task"].append({**rows["change-of-task"][0], **bad, "bump_N": 1.5})
    unmet = [each for each in axes.requirements(rows) if not each["met"]]
    assert [(each["limit"], each["worst_result"]) for each in unmet] == [(1.0, 1.5)]
    worst = {(row["scene"], row["loop_hz"]): row for row in axes.worst_by_rate(rows)}
    assert worst["change of task", 250.0]["settling_s"] == inf
    required = [*axes.requirements({scene: [] for scene in axes.TABLES})]
    assert len(required) == len(axes.LIMITS)
    assert not any(each["met"] for each in required)
