"""The estimated compliance of the arm: bounded, for any delay, and kept."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.regulator.estimates import SOFTEST_ARM_N_M, FitSettings, ResponseShare

DT_S, TIME_S = 0.004, 0.03
SETTINGS = FitSettings(2e5, memory_s=0.1, noise_N=0.15)
ARM_N_M = 8e5  # of the servos, in series with the contact
stiffnesses = st.floats(1e4, 2e5)
lates = st.floats(-0.005, 0.005)
seeds = st.integers(0, 2**32 - 1)


def add(state, travel, speed, force, k) -> None:
    """Update the estimate by one sample."""
    state.update((travel, speed, force), k, dt_s=DT_S, settings=SETTINGS)


def released(k, total_k, late_s=0.0, *, noise_N=0.0, seed=0) -> ResponseShare:
    """Yield from 30 N, first faster; the force responds with `total_k`, later than assumed."""
    rng, state = np.random.default_rng(seed), ResponseShare()
    for number in range(80):
        t = number * DT_S
        travel_m = 30.0 / total_k * (1.0 - (1.0 + t / TIME_S) * np.exp(-t / TIME_S))
        speed_m_s = 30.0 / total_k * t / TIME_S**2 * np.exp(-t / TIME_S)
        force_N = 30.0 - total_k * (travel_m - late_s * speed_m_s) + noise_N * rng.normal()
        add(state, travel_m, speed_m_s, force_N, k)
    return state


def softest(k) -> float:
    """Return the least permitted share."""
    return 1.0 / (1.0 + k / SOFTEST_ARM_N_M)


@given(stiffnesses, lates)
def test_a_compliant_arm_is_identified_for_any_delay(k, late_s) -> None:
    """The estimate is never softer than the arm and at most an eighth stiffer."""
    share = ARM_N_M / (ARM_N_M + k)
    share_found = released(k, share * k, late_s).share
    assert 0.99 * share <= share_found <= 1.125 * share


@settings(max_examples=40)
@given(stiffnesses, seeds)
def test_noise_does_not_make_it_soft(k, seed) -> None:
    """With the sensor's noise the estimate stays above nine tenths of the true value."""
    share = ARM_N_M / (ARM_N_M + k)
    assert released(k, share * k, noise_N=0.1, seed=seed).share >= 0.9 * share


@given(stiffnesses, st.floats(0.0, 2.0))
def test_an_arm_that_does_not_follow_never_counts_as_soft(k, followed) -> None:
    """The force responds by any part of the expected one, or not at all: the bound holds."""
    share = released(k, max(followed * k, 1.0)).share
    assert softest(k) - 1e-12 <= share <= 1.0


@given(seeds)
def test_without_motion_nothing_is_estimated(seed) -> None:
    """Noise alone does not change the estimate."""
    rng, state = np.random.default_rng(seed), ResponseShare()
    for _ in range(60):
        add(state, 0.0, 0.0, 10.0 + rng.normal(), 2e4)
    assert state.share == 1.0


@given(st.lists(st.tuples(*[st.floats(-1e-2, 1e-2)] * 2, st.floats(-100, 100)), max_size=60))
def test_the_estimate_stays_within_its_bounds_for_any_sample(samples) -> None:
    """For any travel, speed and force it is between the share of the softest arm and one."""
    state = ResponseShare()
    for travel, speed, force in samples:
        add(state, travel, speed, force, 5e4)
        assert softest(5e4) <= state.share <= 1.0


def test_the_estimate_is_kept_without_new_motion() -> None:
    """A tool at rest after a release keeps its estimate."""
    state = released(2e5, 1.6e5)
    released_share = state.share
    for _ in range(100):
        add(state, 1.9e-4, 0.0, 0.0, 2e5)
    assert state.share == pytest.approx(released_share, rel=0.03)
