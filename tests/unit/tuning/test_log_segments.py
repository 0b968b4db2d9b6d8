"""Parts of a log: gaps, segments by set point or force, clipping, drift, and frequencies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.force_logs import RATE_HZ, first_order, noise, second_order, times
from tuning.flat_tops import flat_tops
from tuning.force_log import Signal, sampling_of
from tuning.log_segments import segments_of
from tuning.log_steadiness import drift_of, spectrum_of


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


def test_a_part_includes_its_begin_and_the_end_of_the_signal() -> None:
    """The sample at the end of a part belongs to the next one."""
    signal = Signal(np.arange(10.0), np.arange(10.0))
    assert signal.between(2.0, 5.0).value.tolist() == [2.0, 3.0, 4.0]
    assert signal.between(7.0, 9.0).value.tolist() == [7.0, 8.0, 9.0]
    assert Signal(np.empty(0), np.empty(0)).between(0.0, 1.0).value.tolist() == []


@given(
    level=st.floats(1.0, 500.0),
    at_s=st.floats(0.5, 3.5),
    tau_s=st.floats(0.005, 0.3),
    sign=st.sampled_from((1.0, -1.0)),
)
def test_a_step_of_the_force_is_found_where_it_begins(level, at_s, tau_s, sign) -> None:
    """Within 2 % of the response, whatever its size, sign and speed."""
    time_s = times()
    segments = segments_of(Signal(time_s, sign * level * first_order(time_s, tau_s, at_s)), None)
    assert len(segments) == 2
    assert segments[1].begin_s == pytest.approx(at_s, abs=0.002 + 0.03 * tau_s)
    assert segments[1].before == pytest.approx(0.0, abs=0.02 * level)
    final = sign * level * -np.expm1(-(5.0 - at_s) / tau_s)
    assert segments[1].target == pytest.approx(final, rel=0.05)


@given(seed=st.integers(0, 10_000), slope=st.floats(-5.0, 5.0))
def test_noise_and_drift_are_no_step(seed: int, slope: float) -> None:
    """The log is one segment without a target."""
    time_s = times(2.0)
    (only,) = segments_of(Signal(time_s, slope * time_s + noise(1000, 0.3, seed)), None)
    assert only.step is None
    assert (only.begin_s, only.end_s) == (0.0, time_s[-1])


def test_a_force_that_wanders_has_no_step_in_nine_of_ten_logs() -> None:
    """A step leads from rest to rest."""
    walks = [Signal(times(2.0), np.cumsum(noise(1000, 0.3, seed))) for seed in range(100)]
    assert sum(len(segments_of(walk, None)) > 1 for walk in walks) <= 10


@given(ramp_s=st.floats(0.01, 2.0), rate_hz=st.sampled_from((10.0, 100.0, 500.0)))
def test_a_ramp_of_the_set_point_is_one_step(ramp_s: float, rate_hz: float) -> None:
    """Also one that is sent in stairs of up to 0.1 s."""
    time_s = times()
    stairs = np.floor(time_s * rate_hz + 1e-9) / rate_hz
    aimed = 10.0 * np.clip((stairs - 1.0) / ramp_s, 0.0, 1.0)
    found = segments_of(Signal(time_s, aimed), Signal(time_s, aimed))
    assert [each.before for each in found] == [None, 0.0]
    assert found[1].target == pytest.approx(10.0)


def test_a_gap_at_the_end_of_a_segment_leaves_its_last_sample_as_the_level() -> None:
    """The next step begins with the first sample after the gap."""
    time_s = times()
    force = 10.0 * (first_order(time_s, 0.01) - first_order(time_s, 0.01, 3.0))
    kept = (time_s < 1.8) | (time_s >= 3.0)
    found = segments_of(Signal(time_s[kept], force[kept]), None)
    assert found[1].target == pytest.approx(10.0)
    assert found[2].begin_s == pytest.approx(3.0)


def wave(seed: int, hertz: float) -> np.ndarray:
    """Return a noisy sine of amplitude 10 N."""
    return 10.0 * np.sin(2.0 * np.pi * hertz * times()) + noise(2500, 0.05, seed)


@given(seed=st.integers(0, 1000), hertz=st.floats(0.5, 20.0), share=st.floats(0.3, 0.9))
def test_an_added_clipping_is_found_with_its_value(seed: int, hertz: float, share: float) -> None:
    """At the top, at the bottom, and at both."""
    signal, limit = wave(seed, hertz), 10.0 * share
    assert flat_tops(np.maximum(signal, 0.0)) == []  # the absence of contact
    assert [top.value for top in flat_tops(np.minimum(signal, limit))] == [limit]
    assert [top.value for top in flat_tops(np.maximum(signal, -limit))] == [-limit]
    both = flat_tops(np.clip(signal, -limit, limit))
    assert [top.value for top in both] == [limit, -limit]
    assert all(top.samples >= top.longest >= 3 and top.places >= 1 for top in both)


@given(seed=st.integers(0, 1000), hertz=st.floats(0.5, 20.0), digits=st.integers(0, 4))
def test_a_signal_within_its_range_has_no_flat_top(seed: int, hertz: float, digits: int) -> None:
    """Whatever its resolution."""
    assert flat_tops(np.round(wave(seed, hertz), digits)) == []


@pytest.mark.parametrize("tau_s", [0.005, 0.05, 0.2])
def test_a_force_without_noise_that_comes_to_rest_is_no_flat_top(tau_s: float) -> None:
    """As in a simulation: equal to its set point to the last digit."""
    assert flat_tops(20.0 * first_order(times(20.0), tau_s)) == []
    assert flat_tops(20.0 * second_order(times(20.0), damping=0.4, rad_s=1.0 / tau_s)) == []


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
