"""Forecast of a press: refusals by name, and its dependence on cell and job."""

import json
import re
from math import exp, log
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from control.gain_rule import LOOP_GAIN
from forcemesh.errors import DataError
from tests.fakes.bench import CELL, cell_with
from tuning import forecast_text
from tuning.force_map import FILE, QuantityFit, check_value, force_map
from tuning.forecast import ForceJob, forecast, loop_gain, not_covered
from tuning.forecast_text import arming_text, rows, warnings

SETPOINTS = st.floats(5.0, 40.0)
STIFFNESSES = st.floats(5e3, 2e4)
LAWS = st.sampled_from(["plain", "adaptive"])


@given(setpoint_N=SETPOINTS, k=STIFFNESSES, law_name=LAWS)
def test_every_interval_is_at_most_twice_as_high_as_low(setpoint_N, k, law_name) -> None:
    """And positive, for any job that is covered."""
    found = forecast(CELL, ForceJob(setpoint_N, k, law_name))
    intervals = [found.settling_s, found.peak_N, found.follow_error_N]
    for interval in intervals:
        assert interval is None or 0.0 < interval.low < interval.high <= 2.0001 * interval.low
    assert found.law == law_name
    assert found.stiffness_N_m == k


SLOWLY = {"force__approach_m_s": 0.001}
SLOW_LOOP = SLOWLY | {"rates__control_hz": 10.0, "rates__robot_hz": 10.0}
SOFT_ONLY = SLOWLY | {
    "rates__control_hz": 31.0, "rates__robot_hz": 31.0, "robot__delay_s": 0.06,
    "contact__stiffness_N_m": 6e3,
}  # fmt: skip
NO_TRACKING = {"force__surface_tracking": False, "force__law": "adaptive"}
REFUSED: list[tuple[dict[str, Any], ForceJob, str]] = [
    ({}, ForceJob(15.0, host="controller"), "host controller: the map was measured with host pc"),
    ({}, ForceJob(15.0, mode="both"), "mode both: the map was measured with mode position"),
    ({}, ForceJob(15.0, law="integral"), "law integral: the map has adaptive and plain"),
    ({}, ForceJob(2.0), "set point is 2 N, measured were"),
    ({}, ForceJob(90.0), "set point is 90 N, measured were"),
    ({}, ForceJob(15.0, 500.0), "too soft: 500 N/m"),
    (SLOW_LOOP, ForceJob(15.0), "too slow: the loop runs at 10 Hz"),
    (SOFT_ONLY, ForceJob(15.0, 4e3, "adaptive"), "no forecast at 4e+03 N/m: "),
    (SLOWLY | {"robot__delay_s": 0.15}, ForceJob(15.0), "too slow: the loop delay is 174 ms"),
    ({"limits__accel_m_s2": 0.5}, ForceJob(15.0), "limits.accel_m_s2 is 0.5 m/s2"),
    (NO_TRACKING, ForceJob(15.0), "force.surface_tracking off"),
    (
        {"force__delay_compensation": False},
        ForceJob(15.0, law="adaptive"),
        "force.delay_compensation off",
    ),
]


@pytest.mark.parametrize(("changes", "job", "sentence"), REFUSED)
def test_what_the_map_does_not_cover_is_refused_by_name(changes, job, sentence) -> None:
    """Never extrapolated: the text has the value and the measured range."""
    cell = cell_with(**changes)
    text = not_covered(cell, job)
    assert text.startswith("no forecast")
    assert sentence in text
    with pytest.raises(DataError, match=re.escape(text)):
        forecast(cell, job)


def test_where_the_adaptive_law_rang_following_is_not_forecast() -> None:
    """Settling and peak are; the plain law follows there."""
    soft = cell_with(contact__stiffness_N_m=3e3, contact__inertia_kg=2.0)
    found = forecast(soft, ForceJob(15.0, law="adaptive"))
    assert found.follow_error_N is None
    assert "below 0.8 the adaptive law rang" in found.not_followed
    assert forecast(soft, ForceJob(15.0, law="plain")).follow_error_N is not None


@pytest.mark.parametrize("feed_m_s", [1e-6, 0.9])
def test_a_feed_outside_of_the_map_is_not_forecast(feed_m_s: float) -> None:
    """Settling and peak do not depend on it."""
    found = forecast(CELL, ForceJob(15.0, feed_m_s=feed_m_s))
    assert found.follow_error_N is None
    assert "speed of the surface" in found.not_followed
    assert found.settling_s == forecast(CELL, ForceJob(15.0)).settling_s


@pytest.mark.parametrize(
    ("period_s", "inertia_kg_s", "expected"),
    [(0.004, 90.0, 3.4), (0.012, 90.0, (3.4 + LOOP_GAIN) / 2), (0.033, 90.0, LOOP_GAIN)],
)
def test_the_loop_gain_falls_with_the_loop_rate(period_s, inertia_kg_s, expected) -> None:
    """From full prediction to none; inertia caps it."""
    values = {
        "stiffness_N_m": 5e4,
        "loop_delay_s": 0.05,
        "period_s": period_s,
        "inertia_kg_s": inertia_kg_s,
    }
    assert loop_gain("adaptive", values) == pytest.approx(expected)
    heavy = values | {"inertia_kg_s": 1e5}
    assert loop_gain("adaptive", heavy) < 0.1


# --- texts --------------------------------------------------------------------------------------

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


# --- the map ------------------------------------------------------------------------------------

FEATURE = st.floats(-3.0, 3.0)


def fit_of(coefficients: tuple[float, ...], width: float = 0.2) -> QuantityFit:
    """Return a fit with two features."""
    return QuantityFit(("a", "b"), (1.0, -1.0), (2.0, 0.5), coefficients, width)


def test_the_stored_map_is_whole_and_has_both_laws() -> None:
    """Its check value fits; every law has a fit of each quantity."""
    tree = json.loads(FILE.read_text(encoding="utf-8"))
    assert tree["check"] == check_value(tree)
    assert "forecast" in tree["command"]
    maps = force_map()
    assert sorted(maps) == ["adaptive", "plain"]
    for law_map in maps.values():
        assert sorted(law_map.fits) == ["follow_error_N", "peak_N", "settling_s"]
        assert all(0.0 < 2.0 * fit.width <= log(2.0) + 1e-5 for fit in law_map.fits.values())
        assert all(interval.low < interval.high for interval in law_map.ranges.values())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "cannot be read"),
        ("[]", "was changed by hand"),
        (FILE.read_text(encoding="utf-8").replace("7", "8", 1), "was changed by hand"),
    ],
)
def test_a_damaged_map_is_refused_with_the_remedy(text: str, sentence: str, tmp_path: Path) -> None:
    """It names the file and the command."""
    path = tmp_path / "map.json"
    path.write_text(text)
    with pytest.raises(DataError, match=f"map.json: {sentence}.*python -m bench.forecast.fit"):
        force_map(path)


@given(a=FEATURE, b=FEATURE, model=st.floats(0.01, 100.0), width=st.floats(0.01, 0.34))
def test_the_interval_is_the_model_times_the_polynomial(a, b, model, width) -> None:
    """Written out by hand for two features; its ends are a factor exp(2 w) apart."""
    c = (0.1, 0.2, -0.3, 0.01, 0.02, -0.03)
    x, y = (a - 1.0) / 2.0, (b + 1.0) / 0.5
    power = c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y
    found = fit_of(c, width).interval(model, {"a": a, "b": b, "other": 9.0})
    middle = (found.low * found.high) ** 0.5
    assert middle == pytest.approx(model * exp(power), rel=1e-9)
    assert found.high / found.low == pytest.approx(exp(2.0 * width), rel=1e-9)
