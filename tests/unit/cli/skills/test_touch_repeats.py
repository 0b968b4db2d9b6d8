"""Repeated touches: each contact at the place of its event, mean and standard deviation."""

import json
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.skills import pressing
from cli.skills.contact_monitor import no_progress
from cli.skills.touch_repeats import TouchStatistics, contact_text, touch_often
from tests.fakes.bench import CELL
from tests.fakes.verbs import call_verb
from tests.unit.cli.skills.test_verbs import GAP_MM, SkillCell

places = st.lists(st.tuples(*[st.floats(-500.0, 500.0)] * 3), min_size=2, max_size=12)


@pytest.fixture
def cell() -> SkillCell:
    """The demo's cell."""
    return SkillCell()


def approach(cell: SkillCell, retract_m: float) -> partial[pressing.TouchResult]:
    """Return the touch that is repeated."""
    return partial(pressing.touch, cell.client, force_N=5.0, search_m=None, retract_m=retract_m)


@given(places, st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda d: np.linalg.norm(d) > 0.1))
def test_mean_and_deviation_are_those_of_the_places(found, direction) -> None:
    """Per axis with n - 1 in the denominator; along the axis that of the projections."""
    axis = np.array(direction) / np.linalg.norm(direction)
    touches = [pressing.TouchResult(place, 1.0, 2.0) for place in found]
    result = TouchStatistics.of(touches, axis)
    for index in range(3):
        column = [place[index] for place in found]
        mean = sum(column) / len(column)
        variance = sum((each - mean) ** 2 for each in column) / (len(column) - 1)
        assert result.mean_mm[index] == pytest.approx(mean, abs=1e-6)
        assert result.std_mm[index] == pytest.approx(variance**0.5, abs=1e-6)
    first, covariance = np.array(found[0]), np.cov(np.array(found).T)
    assert result.along_std_mm**2 == pytest.approx(axis @ covariance @ axis, rel=1e-6, abs=1e-4)
    assert result.along_mean_mm == pytest.approx(
        (np.array(result.mean_mm) - first) @ axis, abs=1e-6
    )


def test_touches_of_a_rigid_plate_repeat_within_a_tenth_of_a_millimetre(cell: SkillCell) -> None:
    """Each approach starts in free space, and the arm ends retracted."""
    start = cell.p_tcp()
    shown: list[pressing.TouchResult] = []
    result = touch_often(cell.client, approach(cell, 0.003), 3, retract_m=0.003, found=shown.append)
    assert list(result.touches) == shown
    assert len(shown) == 3
    assert result.mean_mm == pytest.approx(1e3 * start - [0.0, 0.0, GAP_MM], abs=0.3)
    assert max(*result.std_mm, result.along_std_mm) < 0.1
    assert abs(result.along_mean_mm) < 0.1
    travels = [found.travel_mm for found in shown]
    assert travels == pytest.approx([GAP_MM, 3.0, 3.0], abs=0.4)
    assert cell.client.contact.wait("free", within_s=1.0).valid
    assert max(found.peak_N for found in shown) < CELL.force.touch_N + CELL.force.approach_budget_N


def test_the_verb_prints_each_contact_and_the_figures(cell: SkillCell, monkeypatch) -> None:
    """As lines, or with --json as one object and the contacts on standard error."""
    words = ("touch", "--repeat", "2", "--back", "2")
    done = call_verb(monkeypatch, cell.client, no_progress, *words)
    lines = done.stdout.splitlines()
    assert done.exit_code == 0
    assert len(lines) == 4
    assert lines[0].startswith("contact with the TCP at ")
    assert lines[2].startswith("mean of 2 contacts: ")
    assert lines[3].startswith("standard deviation: ")
    assert "along the tool axis" in lines[3]
    done = call_verb(monkeypatch, cell.client, no_progress, *words, "--json")
    values = json.loads(done.stdout)
    assert len(values["touches"]) == 2
    assert set(values) == {"touches", "mean_mm", "std_mm", "along_mean_mm", "along_std_mm"}
    assert len(done.stderr.splitlines()) == 2
    first = pressing.TouchResult(tuple(values["touches"][0]["tcp_mm"]), 0.0, 0.0)
    assert contact_text(first).partition(" after")[0] in done.stderr
