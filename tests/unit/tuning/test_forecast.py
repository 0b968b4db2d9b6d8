"""Forecast of a press: refusals by name, and its dependence on cell and job."""

import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell import CellConfig
from forcemesh.errors import DataError
from services.regulator import adaptive, law
from tests.fakes.bench import CELL, cell_with
from tuning import forecast as model
from tuning.forecast import ForceJob, forecast, loop_gain, not_covered
from tuning.gain_rule import LOOP_GAIN

SETPOINTS = st.floats(5.0, 40.0)
STIFFNESSES = st.floats(5e3, 2e4)
LAWS = st.sampled_from(["plain", "adaptive"])


def slow_cell(**changes: Any) -> CellConfig:
    """Return the demo's cell with a loop of 10 Hz."""
    rates = {"rates__control_hz": 10.0, "rates__robot_hz": 10.0}
    return cell_with(**rates, force__approach_m_s=0.001, **changes)


@given(setpoint_N=SETPOINTS, k=STIFFNESSES, law_name=LAWS)
def test_every_interval_is_at_most_twice_as_high_as_low(setpoint_N, k, law_name) -> None:
    """And positive, for any job that is covered."""
    found = forecast(CELL, ForceJob(setpoint_N, k, law_name))
    intervals = [found.settling_s, found.peak_N, found.follow_error_N]
    for interval in intervals:
        assert interval is None or 0.0 < interval.low < interval.high <= 2.0001 * interval.low
    assert found.law == law_name
    assert found.stiffness_N_m == k


REFUSED: tuple[tuple[CellConfig, ForceJob, str], ...] = (
    (CELL, ForceJob(15.0, host="controller"), "host controller: the map was measured with host pc"),
    (CELL, ForceJob(15.0, mode="both"), "mode both: the map was measured with mode position"),
    (CELL, ForceJob(15.0, law="admittance"), "law admittance: the map has adaptive and plain"),
    (CELL, ForceJob(2.0), "set point is 2 N, measured were"),
    (CELL, ForceJob(90.0), "set point is 90 N, measured were"),
    (CELL, ForceJob(15.0, 500.0), "too soft: 500 N/m"),
    (slow_cell(), ForceJob(15.0), "too slow: the loop runs at 10 Hz"),
    (
        cell_with(
            rates__control_hz=31.0,
            rates__robot_hz=31.0,
            robot__delay_s=0.06,
            contact__stiffness_N_m=6e3,
            force__approach_m_s=0.001,
        ),
        ForceJob(15.0, 4e3, "adaptive"),
        "no forecast at 4e+03 N/m: ",
    ),
    (
        cell_with(robot__delay_s=0.15, force__approach_m_s=0.001),
        ForceJob(15.0),
        "too slow: the loop delay is 174 ms",
    ),
    (cell_with(limits__accel_m_s2=0.5), ForceJob(15.0), "limits.accel_m_s2 is 0.5 m/s2"),
    (
        cell_with(force__surface_tracking=False, force__law="adaptive"),
        ForceJob(15.0),
        "force.surface_tracking off",
    ),
    (
        cell_with(force__delay_compensation=False),
        ForceJob(15.0, law="adaptive"),
        "force.delay_compensation off",
    ),
)


@pytest.mark.parametrize(("cell", "job", "sentence"), REFUSED, ids=[row[2] for row in REFUSED])
def test_what_the_map_does_not_cover_is_refused_by_name(cell, job, sentence) -> None:
    """Never extrapolated: the text has the value and the measured range."""
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


def test_the_model_has_the_constants_of_the_laws() -> None:
    """It cannot import them: services are above it."""
    assert law.PROBE_N == model.PROBE_N
    assert adaptive.LOOP[0] == model.LOOP
    assert adaptive.SURE_INERTIA_MARGIN == model.INERTIA_MARGIN
    assert (adaptive.FAST_LOOP_S, adaptive.SLOW_LOOP_S) == (model.FAST_LOOP_S, model.SLOW_LOOP_S)


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
