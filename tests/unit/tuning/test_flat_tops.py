"""Flat tops: clipping is found, and nothing that only resembles it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.force_logs import first_order, noise, second_order, times
from tuning.flat_tops import flat_tops


def wave(seed: int, hertz: float) -> np.ndarray:
    """Return a noisy sine of amplitude 10 N."""
    return 10.0 * np.sin(2.0 * np.pi * hertz * times()) + noise(2500, 0.05, seed)


@given(seed=st.integers(0, 1000), hertz=st.floats(0.5, 20.0), share=st.floats(0.3, 0.9))
def test_an_added_clipping_is_found_with_its_value(seed: int, hertz: float, share: float) -> None:
    """At the top, at the bottom, and at both."""
    signal, limit = wave(seed, hertz), 10.0 * share
    assert [top.value for top in flat_tops(np.minimum(signal, limit))] == [limit]
    assert [top.value for top in flat_tops(np.maximum(signal, -limit))] == [-limit]
    both = flat_tops(np.clip(signal, -limit, limit))
    assert [top.value for top in both] == [limit, -limit]
    assert all(top.samples >= top.longest >= 3 and top.places >= 1 for top in both)


@given(seed=st.integers(0, 1000), hertz=st.floats(0.5, 20.0), digits=st.integers(1, 4))
def test_a_signal_within_its_range_has_no_flat_top(seed: int, hertz: float, digits: int) -> None:
    """Whatever its resolution."""
    assert flat_tops(np.round(wave(seed, hertz), digits)) == []


@given(repeats=st.integers(1, 8))
def test_samples_that_are_logged_several_times_are_no_flat_top(repeats: int) -> None:
    """A log may be faster than its sensor; clipping is still found."""
    signal = np.repeat(wave(1, 2.0), repeats)
    assert flat_tops(signal) == []
    assert [top.value for top in flat_tops(np.minimum(signal, 8.0))] == [8.0]


@pytest.mark.parametrize("tau_s", [0.005, 0.05, 0.2])
def test_a_force_without_noise_that_comes_to_rest_is_no_flat_top(tau_s: float) -> None:
    """As in a simulation: equal to its set point to the last digit."""
    assert flat_tops(20.0 * first_order(times(20.0), tau_s)) == []
    assert flat_tops(20.0 * second_order(times(20.0), damping=0.4, rad_s=1.0 / tau_s)) == []


def test_the_absence_of_contact_is_no_flat_top() -> None:
    """A simulated force is exactly 0 before the first touch, and then not."""
    force = np.concatenate((np.zeros(500), 10.0 + noise(500, 1.0)))
    assert flat_tops(force) == []


def test_four_clipped_samples_are_too_few() -> None:
    """Five are needed."""
    signal = wave(1, 2.0)
    signal[100:104] = 12.0
    assert flat_tops(signal) == []
    signal[104] = 12.0
    (top,) = flat_tops(signal)
    assert (top.value, top.places, top.samples, top.longest) == (12.0, 1, 5, 5)
