"""Segments of a log: by its set point, or by the steps of the force itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.force_logs import first_order, noise, times
from tuning.force_log import Signal
from tuning.log_segments import segments_of, steps_in


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


def test_press_and_release_are_two_steps() -> None:
    """A constant set point is the target of the press only."""
    time_s = times()
    force = 10.0 * (first_order(time_s, 0.05) - first_order(time_s, 0.05, 3.0))
    signal = Signal(time_s, force + noise(len(time_s), 0.05))
    found = segments_of(signal, 10.5)
    assert [each.target for each in found[:2]] == [None, 10.5]
    assert found[2].before == pytest.approx(10.0, abs=0.1)
    assert found[2].target == pytest.approx(0.0, abs=0.1)
    assert [each.begin_s for each in found] == pytest.approx([0.0, 1.0, 3.0], abs=0.02)


@given(ramp_s=st.floats(0.01, 2.0), rate_hz=st.sampled_from((10.0, 100.0, 500.0)))
def test_a_ramp_of_the_set_point_is_one_step(ramp_s: float, rate_hz: float) -> None:
    """Also one that is sent in stairs of up to 0.1 s."""
    time_s = times()
    stairs = np.floor(time_s * rate_hz + 1e-9) / rate_hz
    aimed = 10.0 * np.clip((stairs - 1.0) / ramp_s, 0.0, 1.0)
    found = segments_of(Signal(time_s, aimed), Signal(time_s, aimed))
    assert [each.before for each in found] == [None, 0.0]
    assert found[1].target == pytest.approx(10.0)


def test_a_set_point_that_changes_with_the_first_sample_leaves_no_empty_segment() -> None:
    """The first segment would have no length."""
    time_s = times(1.0)
    aimed = np.where(np.arange(500) >= 1, 5.0, 0.0)
    late = Signal(time_s[1:], np.zeros(499))
    assert [each.target for each in segments_of(late, Signal(time_s, aimed))] == [5.0]


def test_a_gap_at_the_end_of_a_segment_leaves_its_last_sample_as_the_level() -> None:
    """The next step begins with the first sample after the gap."""
    time_s = times()
    force = 10.0 * (first_order(time_s, 0.01) - first_order(time_s, 0.01, 3.0))
    kept = (time_s < 1.8) | (time_s >= 3.0)
    found = segments_of(Signal(time_s[kept], force[kept]), None)
    assert found[1].target == pytest.approx(10.0)
    assert found[2].begin_s == pytest.approx(3.0)


def test_a_step_between_two_levels_that_no_sample_has_begins_where_it_was_found() -> None:
    """The median of two values may be near neither of them."""
    value = np.array([0.0] * 45 + [1.0] * 5 + [10.0] * 50)
    assert steps_in(value) == [(50, 0.5)]
