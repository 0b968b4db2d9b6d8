"""The stiffness estimate: safe from the first sample on, close to the true value in the end."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.regulator.estimates import SOFTEST_CONTACT_N_M, FitSettings, Stiffness

DT_S = 0.004
SETTINGS = FitSettings(2e5, memory_s=0.1, noise_N=0.15)
stiffnesses = st.floats(1e3, 1.5e5)
seeds = st.integers(0, 2**32 - 1)


def stiffest():
    """Return the state without an estimate."""
    return Stiffness(SETTINGS.stiffest_N_m, is_identified=False)


def known(k):
    """Return the state after a press on this stiffness."""
    return Stiffness(k, is_identified=True)


def press(k, noise_N=0.0, seed=0, samples=100, *, state=None, may_soften=True):
    """Yield from 30 N as a law would; return the estimates, and the state at the end."""
    rng = np.random.default_rng(seed)
    state = state or stiffest()
    estimates = [state.k_N_m]
    for number in range(samples):
        force = 30.0 * np.exp(-number / 20.0)
        travel = (30.0 - force) / k
        read = force + noise_N * rng.normal()
        state.update(travel, read, dt_s=DT_S, settings=SETTINGS, may_soften=may_soften)
        estimates.append(state.k_N_m)
    return np.array(estimates), state


@given(stiffnesses)
def test_it_begins_with_the_stiffest_and_decreases_to_just_above_the_true_value(k) -> None:
    """Without noise it is never below, and in the end at most a third above."""
    estimates, state = press(k)
    assert estimates[0] == SETTINGS.stiffest_N_m
    assert (estimates >= k).all()
    assert estimates[-1] <= 1.33 * k
    assert state.is_identified


@settings(max_examples=40)
@given(stiffnesses, seeds)
def test_noise_makes_it_slower_and_not_softer(k, seed) -> None:
    """With the sensor's noise it stays above nine tenths of the true value throughout."""
    estimates, _ = press(k, 0.1, seed)
    assert (estimates >= 0.9 * k).all()


@given(stiffnesses, seeds)
def test_without_motion_nothing_is_estimated(k, seed) -> None:
    """Noise alone, also large noise, does not change the estimate."""
    rng, state = np.random.default_rng(seed), known(k)
    for _ in range(60):
        state.update(0.0, 10.0 + rng.normal(), dt_s=DT_S, settings=SETTINGS)
    assert state.k_N_m == pytest.approx(k)


@given(stiffnesses, seeds)
def test_while_following_a_surface_it_may_only_rise(k, seed) -> None:
    """Travel without force: the tool follows a surface, which gives no stiffness."""
    rng, state = np.random.default_rng(seed), known(k)
    for number in range(100):
        before, force = state.k_N_m, 10.0 + 0.1 * rng.normal()
        state.update(-1e-4 * number, force, dt_s=DT_S, settings=SETTINGS, may_soften=False)
        assert state.k_N_m >= before - 1e-9


@given(stiffnesses, st.floats(20e-6, 100e-6), seeds)
def test_a_tool_nearly_at_rest_does_not_raise_it(k, sway_m, seed) -> None:
    """Small periodic motion, as force feedback has, keeps the estimate of the press."""
    rng, state = np.random.default_rng(seed), known(1.15 * k)
    for number in range(500):
        travel = sway_m * np.sin(number / 8.0)
        read = 10.0 - k * travel + 0.1 * rng.normal()
        state.update(travel, read, dt_s=DT_S, settings=SETTINGS, may_soften=False)
    assert state.k_N_m <= max(1.3 * k, 1.15 * k + 4e3)


@given(stiffnesses)
def test_a_too_stiff_estimate_decreases_also_while_following(k) -> None:
    """Travel that explains the force is the tool's own: the rest would be fed forward."""
    estimates, _ = press(k, state=known(2.0 * k), may_soften=False)
    assert estimates[-1] <= 1.33 * k


@given(st.floats(1e3, 2e4))
def test_a_ten_times_stiffer_contact_is_detected_also_while_following(k) -> None:
    """The estimate rises to the true value within a tenth of a second."""
    estimates, _ = press(10.0 * k, state=known(k), samples=25, may_soften=False)
    assert estimates[-1] >= 9.0 * k


@given(st.lists(st.tuples(st.floats(-1e-2, 1e-2), st.floats(-100, 100)), max_size=60))
def test_the_estimate_stays_within_its_bounds_for_any_pair(pairs) -> None:
    """For any travel and force it is finite, between the softest and the stiffest."""
    state = stiffest()
    for travel, force in pairs:
        state.update(travel, force, dt_s=DT_S, settings=SETTINGS)
        assert SOFTEST_CONTACT_N_M <= state.k_N_m <= SETTINGS.stiffest_N_m
