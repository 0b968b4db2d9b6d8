"""The stiffness that is believed: safe from the first sample on, near the truth in the end."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.regulator.stiffness import StiffnessSettings, initial, stiffest, update

DT_S = 0.004
SETTINGS = StiffnessSettings(2e5, 200.0, 0.1, 0.15, 1e-5)
stiffnesses = st.floats(1e3, 1.5e5)
seeds = st.integers(0, 2**32 - 1)


def press(k, noise_N=0.0, seed=0, samples=100, *, state=None, may_soften=True):
    """Give way along all axes from 30 N as a law would; return every state."""
    rng = np.random.default_rng(seed)
    states = [state or stiffest(SETTINGS)]
    for number in range(samples):
        force = np.full(3, 30.0 * np.exp(-number / 20.0))
        way = (30.0 - force) / k
        read = force + noise_N * rng.normal(size=3)
        after = update(states[-1], way, read, dt_s=DT_S, settings=SETTINGS, may_soften=may_soften)
        states.append(after)
    return states


@given(stiffnesses)
def test_it_begins_with_the_stiffest_and_comes_down_to_just_above_the_truth(k) -> None:
    """Without noise it is never below, and in the end at most a third above."""
    believed = np.array([state.k for state in press(k)])
    assert (believed[0] == SETTINGS.stiffest).all()
    assert (believed >= k).all()
    assert (believed[-1] <= 1.33 * k).all()
    assert press(k)[-1].identified.all()


@settings(max_examples=40)
@given(stiffnesses, seeds)
def test_noise_makes_it_slower_not_softer(k, seed) -> None:
    """With the sensor's noise it stays above nine tenths of the truth all the way."""
    believed = np.array([state.k for state in press(k, 0.1, seed)])
    assert (believed >= 0.9 * k).all()


@given(stiffnesses, seeds)
def test_without_motion_nothing_is_learned(k, seed) -> None:
    """Noise alone, also with much of it, does not move what is believed."""
    rng, state = np.random.default_rng(seed), initial(np.full(3, k))
    for _ in range(60):
        read = 10.0 + rng.normal(size=3)
        state = update(state, np.zeros(3), read, dt_s=DT_S, settings=SETTINGS)
    assert state.k == pytest.approx(np.full(3, k))


@given(stiffnesses, seeds)
def test_where_a_surface_is_followed_it_may_only_rise(k, seed) -> None:
    """Way without force: the tool follows a surface, which says nothing about stiffness."""
    rng, state = np.random.default_rng(seed), initial(np.full(3, k))
    for number in range(100):
        way, force = np.full(3, -1e-4 * number), 10.0 + 0.1 * rng.normal(size=3)
        after = update(state, way, force, dt_s=DT_S, settings=SETTINGS, may_soften=False)
        assert (after.k >= state.k - 1e-9).all()
        state = after


@given(stiffnesses, st.floats(20e-6, 100e-6), seeds)
def test_a_tool_that_stands_nearly_still_does_not_drive_it_up(k, sway_m, seed) -> None:
    """Swaying a little, as force feedback does, over and over: it stays where pressing had it."""
    rng, state = np.random.default_rng(seed), initial(np.full(3, 1.15 * k))
    for number in range(500):
        way = np.full(3, sway_m * np.sin(number / 8.0))
        read = 10.0 - k * way + 0.1 * rng.normal(size=3)
        state = update(state, way, read, dt_s=DT_S, settings=SETTINGS, may_soften=False)
    assert (state.k <= max(1.3 * k, 1.15 * k + 4e3)).all()


@given(stiffnesses)
def test_what_was_believed_too_stiff_comes_down_also_while_following(k) -> None:
    """Where the way explains the force it is the tool's own way: the rest would be fed forward."""
    state = initial(np.full(3, 2.0 * k))
    assert (press(k, state=state, may_soften=False)[-1].k <= 1.33 * k).all()


@given(st.floats(1e3, 2e4))
def test_something_ten_times_stiffer_is_noticed_also_while_following(k) -> None:
    """What was believed rises to the truth within a tenth of a second."""
    state = initial(np.full(3, k))
    found = press(10.0 * k, state=state, samples=25, may_soften=False)[-1]
    assert (found.k >= 9.0 * k).all()


@given(st.lists(st.tuples(st.floats(-1e-2, 1e-2), st.floats(-100, 100)), max_size=60))
def test_it_stays_within_its_bounds_whatever_it_is_told(pairs) -> None:
    """Any ways and forces: between the softest and the stiffest, finite."""
    state = stiffest(SETTINGS)
    for way, force in pairs:
        sample = np.full(3, way), np.full(3, force)
        state = update(state, *sample, dt_s=DT_S, settings=SETTINGS)
        assert (state.k >= SETTINGS.softest).all()
        assert (state.k <= SETTINGS.stiffest).all()


def test_every_axis_is_judged_by_itself() -> None:
    """A soft axis beside a stiff one and one that does not move."""
    state = stiffest(SETTINGS)
    k = np.array([5e3, 1e5, 1e4])
    for number in range(60):
        force = np.array([30.0, 30.0, 5.0]) * np.exp(-number / 20.0 * np.array([1, 1, 0]))
        way = (np.array([30.0, 30.0, 5.0]) - force) / k
        state = update(state, way, force, dt_s=DT_S, settings=replace(SETTINGS))
    assert state.k[:2] == pytest.approx(k[:2], rel=0.4)
    assert state.k[2] == SETTINGS.stiffest
    assert state.identified.tolist() == [True, True, False]
