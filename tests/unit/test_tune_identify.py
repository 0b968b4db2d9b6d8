"""Delay, lag and stiffness come out of noisy records as they went in, or it is said why not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.tuning.identify import Steps, identify, loop_delay, spring
from common.errors import DataError

FINE_S = 2e-4


def record(delay_s, lag_s, noise_m, hz=250.0, seen_hz=250.0, seed=0) -> Steps:
    """Return 4 mm out and back at 40 mm/s, seen through a delay and a lag."""
    sent_s = np.arange(0.0, 1.2, 1.0 / hz)
    speed = np.where((sent_s > 0.1) & (sent_s < 0.2), 0.04, 0.0)
    speed -= np.where((sent_s > 0.5) & (sent_s < 0.6), 0.04, 0.0)
    sent_m = np.cumsum(speed) / hz
    fine_s = np.arange(0.0, 1.7, FINE_S)
    share = 1.0 - np.exp(-FINE_S / max(0.5 * lag_s, 1e-9))
    first = arm = 0.0
    arms = []
    for value in sent_m[np.searchsorted(sent_s, fine_s, side="right") - 1]:
        first += share * (value - first)
        arm += share * (first - arm)
        arms.append(arm)
    seen_s = np.arange(delay_s + 0.001, 1.6, 1.0 / seen_hz)
    seen_m = np.interp(seen_s - delay_s - FINE_S, fine_s, arms)
    noise = np.random.default_rng(seed).normal(0.0, noise_m, len(seen_s))
    return Steps(sent_s, sent_m, seen_s, seen_m + 0.7 + noise)


@settings(max_examples=6)
@given(
    st.floats(0.0, 0.12),
    st.floats(0.003, 0.05),
    st.floats(0.0, 3e-5),
    st.sampled_from([40.0, 100.0, 250.0]),
    st.integers(0, 99),
)
def test_delay_and_lag_are_found_through_noise(delay_s, lag_s, noise_m, seen_hz, seed) -> None:
    """Together to a millisecond, which is what gains depend on; the split less sharply.

    Reports at 40 Hz hit the corners of the motion by luck: there it is known to 10 ms alone.
    """
    found = identify(record(delay_s, lag_s, noise_m, seen_hz=seen_hz, seed=seed))
    assert found.delay_s + found.lag_s == pytest.approx(delay_s + lag_s, abs=1.2e-3)
    assert found.delay_s == pytest.approx(delay_s, abs=4e-3 if seen_hz > 50.0 else 1e-2)
    assert found.rest_m < 2.0 * noise_m + 1e-5
    assert found.spread_s < 1e-3


@given(
    st.floats(2.7, 5.3).map(lambda x: 10.0**x),
    st.integers(0, 1000),
)
def test_a_stiffness_is_found_and_its_bound_is_rarely_too_soft(k, seed) -> None:
    """Five places at rest, poses good to 2 um and forces to 0.02 N: within four deviations."""
    rng = np.random.default_rng(seed)
    forces = np.array([4.0, 8.0, 12.0, 8.0, 4.0])
    ways = forces / k + rng.normal(0.0, 2e-6, 5)
    found = spring(ways + 0.2, forces + rng.normal(0.0, 0.02, 5))
    assert found.k_N_m == pytest.approx(k, rel=0.02 + 4.0 * 2e-6 * k / 8.0)
    assert found.bound_N_m >= found.k_N_m


@settings(max_examples=10)
@given(st.floats(0.02, 0.15), st.floats(0.1, 0.6), st.integers(0, 99))
def test_a_closed_loops_delay_is_found_from_its_answer(tau_s, c, seed) -> None:
    """By another integration than the one that is fitted, through 0.1 N of noise: to 6 ms."""
    rate, dt_s = c / tau_s, 2e-4
    t = np.arange(0.0, 3.0, dt_s)
    force, late = np.full(len(t), 5.0), round(tau_s / dt_s)
    wanted = np.minimum(10.0, 5.0 + 200.0 * t)
    for n in range(1, len(t)):
        then = force[n - 1 - late] - wanted[n - 1 - late] if n > late else 0.0
        force[n] = force[n - 1] - rate * dt_s * then
    seen = slice(0, None, 20)
    noise = np.random.default_rng(seed).normal(0.0, 0.1, len(t[seen]))
    found = loop_delay(
        t[seen], force[seen] + noise, first_N=5.0, then_N=10.0, ramp_N_s=200.0, rate=rate
    )
    assert found == pytest.approx(tau_s, abs=6e-3)


def test_what_the_records_do_not_tell_is_refused_in_one_sentence() -> None:
    """An arm that stands, that does something else, a press that changes nothing, a mirage."""
    good = record(0.01, 0.01, 0.0)
    stood = Steps(good.sent_s, good.sent_m, good.seen_s, np.zeros_like(good.seen_m))
    with pytest.raises(DataError, match="did not go the small steps"):
        identify(stood)
    wild = Steps(good.sent_s, good.sent_m, good.seen_s, good.seen_m[::-1] * 2.0)
    with pytest.raises(DataError, match="did not do what it was told"):
        identify(wild)
    with pytest.raises(DataError, match="too little was heard"):
        identify(Steps(good.sent_s[:5], good.sent_m[:5], good.seen_s, good.seen_m))
    with pytest.raises(DataError, match="did not change the force enough"):
        spring(np.array([0.0, 1e-4]), np.array([5.0, 5.1]))
    with pytest.raises(DataError, match="does not rise with the way"):
        spring(np.array([1e-4, 0.0]), np.array([5.0, 10.0]))
    t = np.linspace(0.0, 2.0, 200)
    with pytest.raises(DataError, match="did not follow its set point"):
        loop_delay(t, 5.0 + 0.0 * t, first_N=5.0, then_N=10.0, ramp_N_s=200.0, rate=5.0)
