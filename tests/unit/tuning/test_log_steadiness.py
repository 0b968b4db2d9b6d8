"""Ripple, drift and spectrum of a force, on signals with known figures."""

from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.force_logs import RATE_HZ, noise, times
from tuning.force_log import Signal
from tuning.log_steadiness import drift_of, ripple_of, spectrum_of


@given(
    amplitude=st.floats(0.01, 100.0),
    slope=st.floats(-10.0, 10.0),
    level=st.floats(-500.0, 500.0),
    hertz=st.integers(5, 100),
)
def test_the_ripple_of_a_sine_is_its_rms_whatever_level_and_drift(
    amplitude: float, slope: float, level: float, hertz: int
) -> None:
    """Amplitude over the square root of two, over whole periods."""
    time_s = times(4.0)
    wave = amplitude * np.sin(2.0 * np.pi * hertz * time_s)
    found = ripple_of(Signal(time_s, level + slope * time_s + wave))
    assert found == pytest.approx(amplitude / sqrt(2.0), rel=0.02)


@given(slope=st.floats(-10.0, 10.0), level=st.floats(-500.0, 500.0))
def test_the_drift_of_a_line_is_its_slope(slope: float, level: float) -> None:
    """Without noise the interval is practically zero."""
    time_s = times()
    found = drift_of(Signal(time_s, level + slope * time_s))
    assert found.slope == pytest.approx(slope, abs=1e-9)
    assert found.bound is None or found.bound < 1e-6


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_the_interval_contains_the_true_drift_in_95_percent(correlation: float) -> None:
    """Of 1500 logs, with independent and with correlated noise."""
    time_s, contained = times(1.0), 0
    value = noise(1500 * 600, 0.1).reshape(600, 1500)
    for at in range(1, 600):
        value[at] += correlation * value[at - 1]
    for log in value[100:].T:  # without the start, which is not stationary
        found = drift_of(Signal(time_s, 0.2 * time_s + log))
        assert found.bound is not None
        contained += abs(found.slope - 0.2) <= found.bound
    assert 0.93 <= contained / 1500 <= 0.97


def test_a_constant_has_no_drift_and_a_slow_wave_no_interval() -> None:
    """Half a wave has less than four effective samples."""
    time_s = times(1.0)
    constant = drift_of(Signal(time_s, np.full(500, 7.0)))
    assert (constant.slope, constant.bound, constant.is_significant) == (0.0, 0.0, False)
    wave = drift_of(Signal(time_s, np.cos(6.0 * time_s)))
    assert wave.bound is None
    assert not wave.is_significant


@given(hertz=st.floats(3.0, 220.0), amplitude=st.floats(0.2, 100.0), seed=st.integers(0, 1000))
def test_a_sine_in_noise_is_the_first_peak_with_its_amplitude(hertz, amplitude, seed) -> None:
    """Frequency within half a bin, amplitude within 10 %, also between two bins."""
    time_s = times(8.0)
    wave = amplitude * np.sin(2.0 * np.pi * hertz * time_s + seed)
    value = 5.0 + wave + noise(len(time_s), 0.1 * amplitude, seed)
    found = spectrum_of(Signal(time_s, value), 1.0 / RATE_HZ)
    assert found is not None
    peak = found.peaks[0]
    assert peak.frequency_hz == pytest.approx(hertz, abs=0.15)
    assert peak.amplitude == pytest.approx(amplitude, rel=0.1)


def test_noise_alone_has_a_peak_in_few_logs() -> None:
    """At most one of a hundred logs, short and long."""
    for seconds in (1.0, 10.0):
        time_s = times(seconds)
        found = [
            spectrum_of(Signal(time_s, noise(len(time_s), 1.0, seed)), 1.0 / RATE_HZ)
            for seed in range(200)
        ]
        assert sum(bool(each and each.peaks) for each in found) <= 2


def test_few_samples_have_no_spectrum_and_a_constant_no_peak() -> None:
    """Sixty-four samples are needed."""
    time_s = times(1.0)
    short = Signal(time_s[:63], time_s[:63])
    assert spectrum_of(short, 1.0 / RATE_HZ) is None
    constant = spectrum_of(Signal(time_s, np.full(500, 3.0)), 1.0 / RATE_HZ)
    assert constant is not None
    assert constant.peaks == ()
