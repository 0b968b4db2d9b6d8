"""The stiffness estimate: safe from the first sample on, close to the true value in the end."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.regulator.estimates import SOFTEST_CONTACT_N_M, FitSettings, Stiffness

DT_S = 0.004
SETTINGS = FitSettings(2e5, memory_s=0.1, noise_N=0.15)
stiffnesses = st.floats(1e3, 1.5e5)
seeds = st.integers(0, 2**32 - 1)


def press(k, noise_N=0.0, seed=0, samples=100, *, state=None, may_soften=True):
    """Yield along all axes from 30 N as a law would; return every state."""
    rng = np.random.default_rng(seed)
    states = [state or Stiffness.stiffest(SETTINGS)]
    for number in range(samples):
        force = np.full(3, 30.0 * np.exp(-number / 20.0))
        travel = (30.0 - force) / k
        read = force + noise_N * rng.normal(size=3)
        after = states[-1].after(travel, read, dt_s=DT_S, settings=SETTINGS, may_soften=may_soften)
        states.append(after)
    return states


@given(stiffnesses)
def test_it_begins_with_the_stiffest_and_decreases_to_just_above_the_true_value(k) -> None:
    """Without noise it is never below, and in the end at most a third above."""
    estimates = np.array([state.k for state in press(k)])
    assert (estimates[0] == SETTINGS.stiffest_N_m).all()
    assert (estimates >= k).all()
    assert (estimates[-1] <= 1.33 * k).all()
    assert press(k)[-1].identified.all()


@settings(max_examples=40)
@given(stiffnesses, seeds)
def test_noise_makes_it_slower_and_not_softer(k, seed) -> None:
    """With the sensor's noise it stays above nine tenths of the true value throughout."""
    estimates = np.array([state.k for state in press(k, 0.1, seed)])
    assert (estimates >= 0.9 * k).all()


@given(stiffnesses, seeds)
def test_without_motion_nothing_is_estimated(k, seed) -> None:
    """Noise alone, also large noise, does not change the estimate."""
    rng, state = np.random.default_rng(seed), Stiffness.known(np.full(3, k))
    for _ in range(60):
        read = 10.0 + rng.normal(size=3)
        state = state.after(np.zeros(3), read, dt_s=DT_S, settings=SETTINGS)
    assert state.k == pytest.approx(np.full(3, k))


@given(stiffnesses, seeds)
def test_while_following_a_surface_it_may_only_rise(k, seed) -> None:
    """Travel without force: the tool follows a surface, which gives no stiffness."""
    rng, state = np.random.default_rng(seed), Stiffness.known(np.full(3, k))
    for number in range(100):
        travel, force = np.full(3, -1e-4 * number), 10.0 + 0.1 * rng.normal(size=3)
        after = state.after(travel, force, dt_s=DT_S, settings=SETTINGS, may_soften=False)
        assert (after.k >= state.k - 1e-9).all()
        state = after


@given(stiffnesses, st.floats(20e-6, 100e-6), seeds)
def test_a_tool_nearly_at_rest_does_not_raise_it(k, sway_m, seed) -> None:
    """Small periodic motion, as force feedback has, keeps the estimate of the press."""
    rng, state = np.random.default_rng(seed), Stiffness.known(np.full(3, 1.15 * k))
    for number in range(500):
        travel = np.full(3, sway_m * np.sin(number / 8.0))
        read = 10.0 - k * travel + 0.1 * rng.normal(size=3)
        state = state.after(travel, read, dt_s=DT_S, settings=SETTINGS, may_soften=False)
    assert (state.k <= max(1.3 * k, 1.15 * k + 4e3)).all()


@given(stiffnesses)
def test_a_too_stiff_estimate_decreases_also_while_following(k) -> None:
    """Travel that explains the force is the tool's own: the rest would be fed forward."""
    state = Stiffness.known(np.full(3, 2.0 * k))
    assert (press(k, state=state, may_soften=False)[-1].k <= 1.33 * k).all()


@given(st.floats(1e3, 2e4))
def test_a_ten_times_stiffer_contact_is_detected_also_while_following(k) -> None:
    """The estimate rises to the true value within a tenth of a second."""
    state = Stiffness.known(np.full(3, k))
    found = press(10.0 * k, state=state, samples=25, may_soften=False)[-1]
    assert (found.k >= 9.0 * k).all()


@given(st.lists(st.tuples(st.floats(-1e-2, 1e-2), st.floats(-100, 100)), max_size=60))
def test_the_estimate_stays_within_its_bounds_for_any_pair(pairs) -> None:
    """For any travel and force it is finite, between the softest and the stiffest."""
    state = Stiffness.stiffest(SETTINGS)
    for travel, force in pairs:
        sample = np.full(3, travel), np.full(3, force)
        state = state.after(*sample, dt_s=DT_S, settings=SETTINGS)
        assert (state.k >= SOFTEST_CONTACT_N_M).all()
        assert (state.k <= SETTINGS.stiffest_N_m).all()


def test_every_axis_is_estimated_by_itself() -> None:
    """One axis is soft, one stiff, and one does not move."""
    state = Stiffness.stiffest(SETTINGS)
    k = np.array([5e3, 1e5, 1e4])
    for number in range(60):
        force = np.array([30.0, 30.0, 5.0]) * np.exp(-number / 20.0 * np.array([1, 1, 0]))
        travel = (np.array([30.0, 30.0, 5.0]) - force) / k
        state = state.after(travel, force, dt_s=DT_S, settings=replace(SETTINGS))
    assert state.k[:2] == pytest.approx(k[:2], rel=0.4)
    assert state.k[2] == SETTINGS.stiffest_N_m
    assert state.identified.tolist() == [True, True, False]
