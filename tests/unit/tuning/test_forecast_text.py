"""Texts of forecasts: broken limits with number and remedy, the note of arming, a line, a table."""

import re

import pytest

from forcemesh.errors import DataError
from tests.fakes.bench import CELL, cell_with
from tuning import forecast_text
from tuning.forecast import ForceJob, forecast
from tuning.forecast_text import arming_text, rows, warnings

STIFF = cell_with(contact__stiffness_N_m=9e4, force__approach_m_s=0.001)


def test_the_fed_force_above_its_ceiling_is_warned_of_with_a_feed_that_is_not() -> None:
    """The remedy holds: with the named feed there is no warning."""
    job = ForceJob(35.0, feed_m_s=0.045, slope_deg=30.0)
    (text,) = warnings(CELL, job, forecast(CELL, job))
    assert text.startswith("at 45 mm/s across a slope of 30 degrees the force may rise from 35 N")
    assert "limits.force_N is 60 N, where the arm holds" in text
    found = re.search(r"feed at most ([\d.]+) mm/s", text)
    assert found is not None
    slower = ForceJob(35.0, feed_m_s=float(found[1]) / 1e3, slope_deg=30.0)
    assert list(warnings(CELL, slower, forecast(CELL, slower))) == []


def test_a_force_that_no_feed_keeps_below_the_ceiling_is_remedied_by_its_set_point() -> None:
    """The set point itself has no room."""
    tight = CELL.model_copy(update={"limits": CELL.limits.model_copy(update={"force_N": 30.5})})
    job = ForceJob(30.0)
    peak, feed = warnings(tight, job, forecast(tight, job))
    assert "the press may peak at" in peak
    assert peak.endswith("limits.force_N is 30.5 N, where the arm holds: lower the set point")
    assert feed.endswith("where the arm holds: lower the set point")


def test_the_note_of_arming_has_the_number_and_the_remedy() -> None:
    """For the largest set point of the cell on its own contact."""
    text = arming_text(STIFF)
    assert text.startswith("; forecast: at 20 mm/s across a slope of 10 degrees the force may rise")
    assert "limits.force_N is 60 N" in text
    assert arming_text(CELL) == ""


@pytest.mark.parametrize(
    "changes",
    [
        {"robot__hosts": ["controller"]},
        {"force__law": "iron"},
        {"contact__inertia_kg": 6.0},
    ],
)
def test_a_cell_that_the_map_does_not_cover_has_no_note(changes: dict[str, object]) -> None:
    """Arming is not delayed by what is unknown."""
    assert arming_text(cell_with(**changes)) == ""


def test_a_damaged_map_does_not_stop_the_arbiter(monkeypatch: pytest.MonkeyPatch) -> None:
    """The note says so."""

    def damaged() -> None:
        raise DataError("map.json: was changed by hand")

    monkeypatch.setattr(forecast_text, "force_map", damaged)
    assert arming_text(CELL) == "; no forecast: map.json: was changed by hand"


def test_the_rows_have_limits_and_verdicts() -> None:
    """Within, possibly above, above; lost downhill; not covered."""

    def verdicts(job: ForceJob) -> list[str]:
        return [row.verdict for row in rows(CELL, job, forecast(CELL, job))]

    assert verdicts(ForceJob(15.0)) == ["", "within", "within"]
    assert verdicts(ForceJob(35.0, feed_m_s=0.045, slope_deg=30.0)) == ["", "within", "above"]
    assert verdicts(ForceJob(6.0, feed_m_s=0.03)) == ["", "within", "contact may be lost downhill"]
    assert verdicts(ForceJob(15.0, feed_m_s=0.9))[-1] == "not covered"
    tight = CELL.model_copy(update={"limits": CELL.limits.model_copy(update={"force_N": 15.0})})
    job = ForceJob(15.0)
    assert rows(tight, job, forecast(tight, job))[1].verdict == "may be above"


def test_a_slope_faster_than_the_arm_may_move_is_warned_of() -> None:
    """With the feed at which it is not."""
    slow = cell_with(force__speed_max_m_s=0.02)
    job = ForceJob(15.0, feed_m_s=0.05, slope_deg=45.0)
    texts = list(warnings(slow, job, forecast(slow, job)))
    assert "force.speed_max_m_s is 20 mm/s: feed at most 20 mm/s" in texts[0]
