"""Quality of a log: figures that are known by formula, and verdicts that no unit changes."""

from dataclasses import replace
from math import log

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.frames import Array
from tests.fakes.force_logs import (
    column,
    first_order,
    noise,
    overshoot_of,
    second_order,
    setpoint_at,
    times,
)
from tuning.force_log import Signal
from tuning.log_quality import Band, LogQuality, quality_of

FIVE_PERCENT = Band(5.0, is_percent=True)
PERIOD_S = 0.002


def judged(
    force: Array,
    setpoint: Array | float | None = None,
    *,
    time_s: Array | None = None,
    band: Band = FIVE_PERCENT,
    mean_s: float = 0.0,
) -> LogQuality:
    """Return the quality of a log with one column."""
    time_s = times() if time_s is None else time_s
    one = column(time_s, force)
    aimed = Signal(time_s, setpoint) if isinstance(setpoint, np.ndarray) else setpoint
    return quality_of([one], one, aimed, band=band, mean_s=mean_s)


def kinds(quality: LogQuality) -> list[str]:
    """Return the kinds of the findings."""
    return [finding.kind for finding in quality.findings]


@given(
    level=st.floats(1.0, 500.0),
    tau_s=st.floats(0.01, 0.5),
    percent=st.sampled_from((2.0, 5.0, 10.0)),
)
def test_a_first_order_response_settles_after_tau_times_the_logarithm_of_the_band(
    level: float, tau_s: float, percent: float
) -> None:
    """Without overshoot; it rises from 10 % to 90 % in tau ln 9."""
    force = level * first_order(times(), tau_s)
    found = judged(force, setpoint_at(times(), level), band=Band(percent, is_percent=True))
    row = found.segments[1]
    assert row.settling_s == pytest.approx(tau_s * log(100.0 / percent), abs=1.01 * PERIOD_S)
    assert row.overshoot_pct == 0.0
    assert row.rise_s == pytest.approx(tau_s * log(9.0), abs=2.01 * PERIOD_S)
    assert row.band == pytest.approx(level * percent / 100.0)


@given(level=st.floats(-500.0, 500.0).filter(lambda x: abs(x) > 1.0), damping=st.floats(0.2, 0.9))
def test_the_overshoot_of_a_second_order_response_is_that_of_its_damping(level, damping) -> None:
    """In percent of the step, whatever its sign."""
    force = level * second_order(times(), damping=damping, rad_s=20.0)
    found = judged(force, setpoint_at(times(), level))
    overshoot_pct = found.segments[1].overshoot_pct
    assert overshoot_pct == pytest.approx(overshoot_of(damping), abs=0.2)
    assert ("overshoot" in kinds(found)) == (overshoot_pct is not None and overshoot_pct > 10.0)


@given(error=st.floats(-0.25, 0.25), ripple=st.floats(0.005, 0.03), slope=st.floats(-0.01, 0.01))
def test_error_ripple_and_drift_are_those_of_the_steady_part(error, ripple, slope) -> None:
    """Of a press with 10 N and white noise; the drift is within its interval, widened."""
    time_s = times(10.0)
    aimed = setpoint_at(time_s, 10.0)
    drift = slope * np.maximum(time_s - 5.5, -4.5)
    force = aimed * (1.0 + error / 10.0) + drift + noise(len(time_s), ripple)
    row = judged(force, aimed, time_s=time_s).segments[1]
    assert row.error == pytest.approx(error, abs=0.01)
    assert row.ripple == pytest.approx(ripple, rel=0.1)
    assert row.drift is not None
    assert row.drift.bound is not None
    assert row.drift.slope == pytest.approx(slope, abs=2.5 * row.drift.bound)


@given(factor=st.floats(1e-3, 1e3), seed=st.integers(0, 1000))
def test_another_unit_changes_no_verdict(factor: float, seed: int) -> None:
    """Forces and set point times a factor: equal times, percents and kinds of findings."""
    force = 20.0 * second_order(times(), damping=0.3, rad_s=20.0) + noise(2500, 0.2, seed)
    force = np.minimum(force, 25.0)
    one = judged(force, setpoint_at(times(), 20.0), mean_s=0.02)
    other = judged(factor * force, factor * setpoint_at(times(), 20.0), mean_s=0.02)
    assert kinds(one) == kinds(other)
    for ours, theirs in zip(one.segments, other.segments, strict=True):
        assert theirs.settling_s == ours.settling_s
        assert theirs.overshoot_pct == pytest.approx(ours.overshoot_pct)
        assert theirs.ripple == pytest.approx(factor * (ours.ripple or 0.0))


def test_a_force_that_leaves_its_band_at_the_end_is_not_settled() -> None:
    """Settled is until the end, for a tenth of the segment at least."""
    aimed = setpoint_at(times(), 10.0)
    for late_s in (4.7, 4.99):
        force = 10.0 * first_order(times(), 0.05) - np.where(
            (times() > late_s) & (times() < late_s + 0.05), 2.0, 0.0
        )
        found = judged(force, aimed)
        assert found.segments[1].settling_s is None
        assert "not_settled" in kinds(found)
        assert found.segments[1].steady_begin_s == pytest.approx(3.0, abs=0.01)


def test_drift_oscillation_and_a_log_without_a_step_are_findings() -> None:
    """Each in a log that has nothing else."""
    aimed = setpoint_at(times(), 10.0)
    steady = 10.0 * first_order(times(), 0.02) + noise(2500, 0.02)
    assert kinds(judged(steady, aimed)) == []
    drifting = steady + 0.1 * np.maximum(times() - 1.0, 0.0)
    assert kinds(judged(drifting, aimed)) == ["drift"]
    shaking = steady + 0.2 * np.sin(2.0 * np.pi * 20.0 * times())
    assert kinds(judged(shaking, aimed)) == ["oscillation", "oscillation"]
    assert kinds(judged(noise(2500, 1.0))) == ["no_step"]


def test_gaps_jitter_repeated_times_and_missing_values_are_findings() -> None:
    """Each in a log that has nothing else."""
    force, aimed = 10.0 * first_order(times(), 0.05) + noise(2500, 0.02), setpoint_at(times(), 10.0)
    without = np.delete(np.arange(2500), np.arange(1500, 1600))
    assert kinds(judged(force[without], aimed[without], time_s=times()[without])) == ["gaps"]
    uneven = times() + np.random.default_rng(1).uniform(-9e-4, 9e-4, 2500)
    assert kinds(judged(force, aimed, time_s=uneven)) == ["jitter"]
    twice = times()
    twice[2000] = twice[1999]
    assert kinds(judged(force, aimed, time_s=twice)) == ["repeated_times"]
    one = replace(column(times(), force), missing=3)
    flat = column(times(), np.zeros(2500), "fx")
    quality = quality_of([one, flat], one, Signal(times(), aimed), band=FIVE_PERCENT)
    assert kinds(quality) == ["missing", "constant"]
