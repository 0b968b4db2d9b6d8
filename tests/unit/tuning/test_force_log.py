"""Times of a force log: gaps, jitter, moving means, even resampling."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.force_logs import times
from tuning.force_log import GAP_FACTOR, Signal, evenly, sampling_of


@given(start=st.integers(100, 1000), length=st.integers(4, 500))
def test_a_removed_stretch_is_one_gap_of_its_length(start: int, length: int) -> None:
    """Its begin is the last sample before it; period and jitter are unchanged."""
    time_s = np.delete(times(), np.arange(start, start + length))
    found = sampling_of(time_s)
    assert len(found.gaps) == 1
    assert found.gaps[0].begin_s == pytest.approx((start - 1) * 0.002)
    assert found.missing_s == pytest.approx(length * 0.002)
    assert found.period_s == pytest.approx(0.002)
    assert found.jitter_s == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("periods", "gaps"), [(GAP_FACTOR - 0.01, 0), (GAP_FACTOR + 0.01, 1)])
def test_a_gap_is_longer_than_three_periods(periods: float, gaps: int) -> None:
    """At the boundary a distance is still jitter."""
    time_s = times(1.0)
    time_s[250:] += (periods - 1.0) * 0.002
    assert len(sampling_of(time_s).gaps) == gaps


def test_a_coarse_clock_gives_repeated_times_and_the_true_period() -> None:
    """Times rounded to 5 ms at 500 Hz: most samples repeat a time."""
    time_s = np.floor(times() / 0.005 + 1e-9) * 0.005
    found = sampling_of(time_s)
    assert found.repeated == pytest.approx(0.6 * len(time_s), abs=2)
    assert found.period_s == pytest.approx(0.005)
    assert found.rate_hz == pytest.approx(200.0)
    assert not found.gaps


@given(window_s=st.floats(0.0, 0.2), value=st.floats(-100.0, 100.0))
def test_a_moving_mean_leaves_a_constant_and_never_exceeds_the_extremes(window_s, value) -> None:
    """Whatever the window, also at the ends."""
    constant = Signal(times(1.0), np.full(500, value))
    assert constant.averaged(window_s).value == pytest.approx(constant.value, abs=1e-9)
    wave = Signal(times(1.0), np.sin(40.0 * times(1.0)))
    assert np.max(np.abs(wave.averaged(window_s).value)) <= np.max(np.abs(wave.value)) + 1e-12


def test_a_part_includes_its_begin_and_the_end_of_the_signal() -> None:
    """The sample at the end of a part belongs to the next one."""
    signal = Signal(np.arange(10.0), np.arange(10.0))
    assert signal.between(2.0, 5.0).value.tolist() == [2.0, 3.0, 4.0]
    assert signal.between(7.0, 9.0).value.tolist() == [7.0, 8.0, 9.0]
    assert Signal(np.empty(0), np.empty(0)).between(0.0, 1.0).value.tolist() == []


def test_the_longest_stretch_is_resampled_evenly() -> None:
    """Samples before a gap are left out; a straight line stays one."""
    time_s = np.concatenate((times(0.2), 1.0 + times(0.8)))
    value = evenly(Signal(time_s, 2.0 * time_s), 0.002)
    assert len(value) == 400
    assert np.diff(value) == pytest.approx(0.004)
    assert len(evenly(Signal(np.empty(0), np.empty(0)), 0.002)) == 0
