"""Identification of delay, lag and stiffness from noisy records, and its refusals."""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcemesh.errors import DataError
from tuning.contact_response import loop_delay
from tuning.contact_spring import fit_spring
from tuning.identify import Steps, identify_servo
from tuning.servo import servo_of

FINE_S = 2e-4


def record(delay_s, lag_s, noise_m=0.0, *, seed=0, smooth=0.0) -> Steps:
    """Return 4 mm out and back at 40 mm/s, measured after a delay and two equal lags.

    Integrated in small steps, unlike the model that is fitted. `smooth` is the share of the lag
    that is a moving average.
    """
    sent_s = np.arange(0.0, 1.2, 0.004)
    speed = np.where((sent_s > 0.1) & (sent_s < 0.2), 0.04, 0.0)
    speed -= np.where((sent_s > 0.5) & (sent_s < 0.6), 0.04, 0.0)
    sent_m = np.cumsum(speed) * 0.004
    fine_s = np.arange(0.0, 1.7, FINE_S)
    command = sent_m[np.searchsorted(sent_s, fine_s, side="right") - 1]
    window = max(1, round(2.0 * smooth * lag_s / FINE_S))
    command = np.convolve(np.pad(command, (window - 1, 0)), np.ones(window) / window, "valid")
    share = 1.0 - np.exp(-FINE_S / max(0.5 * (1.0 - smooth) * lag_s, 1e-9))
    first = arm = 0.0
    arms = []
    for value in command:
        before, first = first, first + share * (value - first)
        arm += share * (0.5 * (before + first) - arm)
        arms.append(arm)
    rng = np.random.default_rng(seed)
    pose_s = np.arange(delay_s + 0.001, 1.6, 0.004)
    pose_m = np.interp(pose_s - delay_s - FINE_S, fine_s, arms)
    return Steps(sent_s, sent_m, pose_s, pose_m + 0.7 + rng.normal(0.0, noise_m, len(pose_s)))


@settings(max_examples=8)
@given(
    st.floats(0.0, 0.06),
    st.floats(0.006, 0.03),
    st.floats(0.0, 0.8),
    st.sampled_from([1e-6, 1e-5]),
    st.integers(0, 99),
)
def test_an_arm_unlike_every_model_is_within_the_stated_bounds(
    d_s, lag_s, smooth, noise_m, seed
) -> None:
    """Its sum is within two deviations, its lag within the range; the bound is never too short."""
    records = [record(d_s, lag_s, noise_m, smooth=smooth, seed=seed + n) for n in range(2)]
    found = servo_of([(identify_servo(one),) for one in records])
    assert abs(found.sum_s - d_s - lag_s) <= 2.0 * found.deviation_s
    least_s, most_s = found.lags_s
    assert least_s <= lag_s <= most_s
    assert found.bound_s >= d_s + lag_s
    assert found.lag_near_s(lag_s) == lag_s
    assert found.lag_near_s(1.0) == most_s


@given(
    st.floats(2.7, 5.3).map(lambda x: 10.0**x),
    st.integers(0, 1000),
)
def test_a_stiffness_is_identified_and_its_bound_is_rarely_too_soft(k, seed) -> None:
    """Five places at rest, poses good to 2 um and forces to 0.02 N: within four deviations."""
    rng = np.random.default_rng(seed)
    forces = np.array([4.0, 8.0, 12.0, 8.0, 4.0])
    penetrations = forces / k + rng.normal(0.0, 2e-6, 5)
    found = fit_spring(penetrations + 0.2, forces + rng.normal(0.0, 0.02, 5))
    assert found.k_N_m == pytest.approx(k, rel=0.02 + 4.0 * 2e-6 * k / 8.0)
    assert found.bound_N_m >= found.k_N_m


@settings(max_examples=10)
@given(st.floats(0.02, 0.15), st.floats(0.1, 0.6), st.integers(0, 99))
def test_the_delay_of_a_closed_loop_is_identified_from_its_step_response(tau_s, c, seed) -> None:
    """The simulation differs from the fitted model: within four stated deviations, of 2 or 3 ms."""
    rate, dt_s = c / tau_s, 2e-4
    t = np.arange(0.0, 3.0, dt_s)
    force, late = np.full(len(t), 5.0), round(tau_s / dt_s)
    target = np.minimum(10.0, 5.0 + 200.0 * t)
    for n in range(1, len(t)):
        then = force[n - 1 - late] - target[n - 1 - late] if n > late else 0.0
        force[n] = force[n - 1] - rate * dt_s * then
    sampled = slice(0, None, 20)
    noise = np.random.default_rng(seed).normal(0.0, 0.1, len(t[sampled]))
    found = loop_delay(
        t[sampled], force[sampled] + noise, first_N=5.0, then_N=10.0, ramp_N_s=200.0, rate=rate
    )
    assert found.deviation_s < 3.5e-3
    assert found.tau_s == pytest.approx(tau_s, abs=4.0 * found.deviation_s + 1e-3)
    assert found.bound_s == pytest.approx(found.tau_s + 2.0 * found.deviation_s)


def test_the_stated_deviation_of_the_sum_covers_19_of_20_records() -> None:
    """Of 40 noisy records two deviations cover the sum in 36, and the deviation is not too wide."""
    errors = []
    for seed in range(40):
        two = identify_servo(record(0.013, 0.011, 1e-5, seed=seed))[1]
        errors.append((two.sum_s - 0.024) / two.sum_deviation_s)
    assert sum(abs(error) <= 2.0 for error in errors) >= 36
    assert sqrt(float(np.mean(np.square(errors)))) > 0.5


def test_records_without_the_information_are_refused_with_the_reason() -> None:
    """An arm at rest, another motion, a press without effect, an implausible delay."""
    good = record(0.01, 0.01)
    last_s, last_m = good.measured_s[-1], good.measured_m[-1]
    late_s = np.append(good.measured_s, last_s + 1.0) + 0.35
    for wrong, reason in (
        ({"measured_m": 0.0 * good.measured_m}, "did not execute the small steps"),
        ({"measured_m": 2.0 * good.measured_m[::-1]}, "does not match the commanded one"),
        ({"commanded_s": good.commanded_s[:5]}, "too few commands and poses"),
        (
            {"measured_s": late_s, "measured_m": np.append(good.measured_m, last_m)},
            "later than 300 ms",
        ),
    ):
        with pytest.raises(DataError, match=reason):
            identify_servo(replace(good, **wrong))
    with pytest.raises(DataError, match="did not change the force enough"):
        fit_spring(np.array([0.0, 1e-4]), np.array([5.0, 5.1]))
    with pytest.raises(DataError, match="does not increase with the penetration"):
        fit_spring(np.array([1e-4, 0.0]), np.array([5.0, 10.0]))
    t = np.linspace(0.0, 2.0, 200)
    with pytest.raises(DataError, match="did not follow its set point"):
        loop_delay(t, 5.0 + 0.0 * t, first_N=5.0, then_N=10.0, ramp_N_s=200.0, rate=5.0)
    late_N = np.interp(t, [0.6, 1.0], [5.0, 10.0])
    with pytest.raises(DataError, match="whose delay is 300 ms at most"):
        loop_delay(t, late_N, first_N=5.0, then_N=10.0, ramp_N_s=200.0, rate=4.0)
