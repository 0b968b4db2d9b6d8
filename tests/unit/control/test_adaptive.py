"""The adaptive law: no step of the command, limits, forgetting, and steps that it never makes."""

from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.load import load_cell
from common.motion.convert import vec3
from common.motion.frames import rotation_between, rotation_from_vector
from control.adaptive import (
    UNPREDICTED_AT,
    AdaptiveSettings,
    begin,
    controller_gain,
    gain_for,
    limit_gain_for_braking,
    step,
)
from control.axis_task import IDENTITY, mode_task
from control.estimates import (
    SOFTEST_ARM_N_M,
    SOFTEST_CONTACT_N_M,
    FitSettings,
    ResponseShare,
    Stiffness,
)
from control.gain_rule import LOOP_GAIN, tune
from control.law import LawMotion, start_at
from control.shape import MotionLimits
from tests.fakes.bench import CELL, DEMO
from tests.fakes.law_input import DT_S, GAINS, START, mode_input, shaped

SETTINGS = AdaptiveSettings.of(CELL)
PLAIN = SETTINGS.plain
PREDICTING = MotionLimits.of(CELL, predicts=True)
UP = -START.rotation[:, 2]
modes = st.sampled_from(["position", "orientation", "both"])
vectors = hnp.arrays(float, 3, elements=st.floats(-60.0, 60.0))
torques = hnp.arrays(float, 3, elements=st.floats(-3.0, 3.0))
histories = st.lists(
    st.tuples(vectors, torques, st.floats(0.0, 40.0), modes), min_size=1, max_size=40
)


def run(samples, *, gains=GAINS):
    """Step through samples; the arm is at the commanded pose."""
    law, adaptive = start_at(START), begin(START, START, None, SETTINGS)
    states = [law]
    for pushed_sample in samples:
        sample = replace(pushed_sample, motion=law, T_measured=law.T_base_tcp, gains=gains)
        adaptive, law = step(adaptive, sample, SETTINGS)
        states.append(shaped(law, sample, PREDICTING))
    return states


def pushed(force_N, setpoint_N=0.0, mode="position", torque_Nm=(0.0, 0.0, 0.0)):
    """Return one sample."""
    return mode_input(vec3(np.array(force_N)), vec3(np.array(torque_Nm)), setpoint_N, mode)


@settings(max_examples=60)
@given(histories, st.booleans())
def test_no_step_is_beyond_the_limits_of_speed_and_acceleration(history, presses) -> None:
    """For any forces, set points and modes; the arbiter need not limit a command."""
    samples = [pushed(f, s, mode, t) if presses else pushed(f) for f, t, s, mode in history]
    poses = [START, *(law.T_base_tcp for law in run(samples))]
    for before, after in pairwise(poses):
        turn_rad = rotation_between(before.rotation, after.rotation)
        assert np.linalg.norm(turn_rad) <= PREDICTING.speed_rad_s * DT_S * (1 + 1e-6)
    speeds_m_s = np.diff([T.translation for T in poses], axis=0) / DT_S
    assert np.linalg.norm(speeds_m_s, axis=1).max() <= PREDICTING.speed_m_s * (1 + 1e-9)
    if not presses:  # an approach has a limit of its own
        changes_m_s = np.linalg.norm(np.diff(speeds_m_s, axis=0), axis=1)
        assert changes_m_s.max() <= CELL.limits.accel_m_s2 * DT_S * (1 + 1e-9)


def test_a_turn_after_a_long_path_estimates_no_surface_motion() -> None:
    """100 mm across, then 2 degrees about the tip at the set force: the surface has not moved."""
    T, adaptive = START.copy(), begin(START, START, (2e4,) * 3, SETTINGS)
    for number in range(600):
        if number < 500:
            T.translation = T.translation + 2e-4 * T.rotation[:, 0]
        else:
            T.rotation = T.rotation @ rotation_from_vector(np.array([0.0, 4e-4, 0.0]))
        law = LawMotion(T.copy(), contact="contact")
        sample = replace(pushed(-10.0 * T.rotation[:, 2], 10.0), motion=law, T_measured=T)
        adaptive, _ = step(adaptive, sample, SETTINGS)
    assert adaptive.tracking.near
    assert abs(adaptive.tracking.drift.speed_m_s) < 1e-4


errors = st.floats(0.0, 100.0)


@given(errors, errors, st.floats(1e-6, 5e-3), st.floats(1e3, 2e5), st.floats(0.5, 10.0))
def test_at_any_error_the_arm_still_comes_to_rest(one_N, other_N, Ki, k, brake_m_s2) -> None:
    """Half the change of v^2 is at most the travel times a; the speed is never above Ki e."""

    def speed_m_s(error_N):
        gain = limit_gain_for_braking([Ki] * 3, [error_N] * 3, [k] * 3, brake_m_s2)
        assert max(gain) <= Ki
        return gain[0] * error_N

    low_N, high_N = sorted((one_N, other_N))
    slow, fast = speed_m_s(low_N), speed_m_s(high_N)
    assert fast >= slow * (1 - 1e-9)
    assert 0.5 * (fast**2 - slow**2) <= brake_m_s2 * (high_N - low_N) / k * (1 + 1e-6) + 1e-12


def test_an_axis_that_is_held_keeps_its_upper_bound_whatever_path_moves_along_it() -> None:
    """Its force is that of motion along the others: the contact along it would look soft."""
    law, adaptive = start_at(START), begin(START, START, None, SETTINGS)
    task = mode_task("position", 10.0, axes=(False, False, True) * 2)
    for number in range(100):
        force_N = np.array([0.02 * number, 0.0, 10.0 + 0.05 * number])
        shift_m = START.rotation @ np.array([-4e-5 * number, 0.0, -5e-6 * number])
        T_measured = pin.SE3(START.rotation, START.translation + shift_m)
        sample = replace(pushed(START.rotation @ force_N), task=task, T_measured=T_measured)
        adaptive, _ = step(adaptive, replace(sample, motion=law), SETTINGS)
    stiffest = SETTINGS.stiffness.stiffest_N_m
    assert [axis.k_N_m for axis in adaptive.stiffness][:2] == [stiffest, stiffest]
    assert adaptive.stiffness[2].k_N_m == pytest.approx(1e4, rel=0.3)


@given(st.floats(200.0, 2e5))
def test_the_controllers_gain_below_the_measured_stiffness_is_the_plain_laws(k_N_m: float) -> None:
    """A loop over TCP: an estimate that is too soft must not make the controller fast."""
    tcp = load_cell(DEMO.with_name("demo-tcp.yaml"))
    chosen = AdaptiveSettings.of(tcp)
    state, gains = begin(START, START, (k_N_m,) * 3, chosen), tune(tcp).gains
    largest = max(controller_gain(state, gains, IDENTITY, chosen))
    if k_N_m < chosen.softest_N_m:
        assert largest == pytest.approx(chosen.plain_gain_m_per_Ns)
    assert largest <= LOOP_GAIN / (chosen.softest_N_m * chosen.tau_s) * (1.0 + 1e-9)


@pytest.mark.parametrize("report_s", [0.004, 0.02, 0.08])
@pytest.mark.parametrize("k", [2e3, 1.5e4])
def test_a_slowly_reported_pose_does_not_lower_the_stiffness(report_s, k) -> None:
    """A report is older than the force until the next one and gives no new sample."""
    rates = CELL.rates.model_copy(update={"robot_hz": 1.0 / report_s})
    chosen = AdaptiveSettings.of(CELL.model_copy(update={"rates": rates}))
    every = round(report_s / DT_S)
    law, adaptive = start_at(START), begin(START, START, None, chosen)
    T_arm = T_report = START.copy()
    estimates = []
    for number in range(500):
        T_arm = pin.SE3(T_arm.rotation, T_arm.translation - 2e-6 * UP)  # 0.5 mm/s into it
        pressed_m = float((START.translation - T_arm.translation) @ UP)
        T_report = T_report if number % every else T_arm
        sample = pushed((k * pressed_m + 0.5) * UP, setpoint_N=1e3)
        is_new = number % every == 0
        sample = replace(sample, pose_is_new=is_new, motion=law, T_measured=T_report)
        adaptive, law = step(adaptive, sample, chosen)
        law = replace(law, T_base_tcp=T_arm)
        estimates.append(adaptive.stiffness[2].k_N_m)
    assert min(estimates) >= 0.98 * k


# --- gain of a sample -----------------------------------------------------------------------------


RULE = [inf] * 3  # requested gains that reduce nothing


@given(st.floats(0.05, 1.0), st.floats(0.05, 1.0), st.floats(200.0, 2e5))
@example(0.85, 1.0, 6400.0)  # prediction rose by a quarter before it fell
def test_a_smaller_gain_share_has_a_lower_gain_and_no_more_prediction(one, other, k_N_m) -> None:
    """Of requests at the rule or above it; from some fall on nothing is predicted."""
    dt_s, tau_s = 1.0 / CELL.rates.control_hz, SETTINGS.tau_s
    less, more = sorted((one, other))
    whole = gain_for([k_N_m] * 3, RULE, SETTINGS, dt_s)
    at_more = gain_for([k_N_m] * 3, RULE, SETTINGS, dt_s, share=more)
    at_less = gain_for([k_N_m] * 3, RULE, SETTINGS, dt_s, share=less)
    for value, other_value, first in zip(at_less, at_more, whole, strict=True):
        assert (np.array(value) <= np.array(other_value) + 1e-15).all()
        assert (np.array(other_value) <= np.array(first) + 1e-15).all()
    if less <= 1.0 - UNPREDICTED_AT:
        assert at_less[1] == pytest.approx([0.0] * 3, abs=1e-9)
        assert (np.array(at_less[0]) <= less * LOOP_GAIN / (k_N_m * tau_s) + 1e-15).all()
    rule = SETTINGS.plain_gain_m_per_Ns
    requested = gain_for([k_N_m] * 3, [0.5 * rule * more] * 3, SETTINGS, dt_s, share=more)
    assert np.array(requested[0]) == pytest.approx(0.5 * np.array(at_more[0]))


# --- estimates ------------------------------------------------------------------------------------

FIT = FitSettings(2e5, memory_s=0.1, noise_N=0.15)
STIFFEST_N_M = FIT.stiffest_N_m
ARM_N_M = 8e5  # of the servos, in series with the contact
seeds = st.integers(0, 2**32 - 1)


def press(k, noise_N=0.0, seed=0, samples=100, *, known=STIFFEST_N_M, may_soften=True):
    """Yield from 30 N as a law would; return the estimates."""
    rng, state = np.random.default_rng(seed), Stiffness(known, is_identified=False)
    estimates = [state.k_N_m]
    for number in range(samples):
        force = 30.0 * np.exp(-number / 20.0)
        read = force + noise_N * rng.normal()
        travel = (30.0 - force) / k
        state.update(travel, read, dt_s=DT_S, settings=FIT, may_soften=may_soften)
        estimates.append(state.k_N_m)
    return np.array(estimates)


@settings(max_examples=40)
@given(st.floats(1e3, 1.5e5), seeds)
def test_the_stiffness_falls_from_the_stiffest_to_just_above_the_true_value(k, seed) -> None:
    """Noise makes it slower, and at most a tenth softer; a stiffer contact is detected at once."""
    exact, noisy = press(k), press(k, 0.1, seed)
    assert exact[0] == STIFFEST_N_M
    assert (exact >= k).all()
    assert exact[-1] <= 1.33 * k
    assert (noisy >= 0.9 * k).all()
    if k < 2e4:  # also while it follows a surface, within a tenth of a second
        assert press(10.0 * k, known=k, samples=25, may_soften=False)[-1] >= 9.0 * k


def released(k, total_k, late_s=0.0, *, noise_N=0.0, seed=0) -> float:
    """Yield from 30 N, first faster; the force responds with `total_k`, later than assumed."""
    rng, state, time_s = np.random.default_rng(seed), ResponseShare(), 0.03
    for t in DT_S * np.arange(80):
        travel_m = 30.0 / total_k * (1.0 - (1.0 + t / time_s) * np.exp(-t / time_s))
        speed_m_s = 30.0 / total_k * t / time_s**2 * np.exp(-t / time_s)
        force_N = 30.0 - total_k * (travel_m - late_s * speed_m_s) + noise_N * rng.normal()
        state.update((travel_m, speed_m_s, force_N), k, dt_s=DT_S, settings=FIT)
    return state.share


@given(st.floats(1e4, 2e5), st.floats(-0.005, 0.005), seeds)
def test_a_compliant_arm_is_identified_for_any_delay(k, late_s, seed) -> None:
    """It is never softer than the arm and at most an eighth stiffer; noise costs a tenth."""
    share = ARM_N_M / (ARM_N_M + k)
    assert 0.99 * share <= released(k, share * k, late_s) <= 1.125 * share
    assert released(k, share * k, noise_N=0.1, seed=seed) >= 0.9 * share
    assert released(k, 0.1 * k) >= 1.0 / (1.0 + k / SOFTEST_ARM_N_M)


@given(st.lists(st.tuples(*[st.floats(-1e-2, 1e-2)] * 2, st.floats(-100, 100)), max_size=60))
def test_both_stay_within_their_bounds_for_any_sample(samples) -> None:
    """The stiffness between softest and stiffest, the share between the softest arm's and one."""
    k, response, softest = 5e4, ResponseShare(), 1.0 / (1.0 + 5e4 / SOFTEST_ARM_N_M)
    stiffness = Stiffness(STIFFEST_N_M, is_identified=False)
    for travel, speed, force in samples:
        response.update((travel, speed, force), k, dt_s=DT_S, settings=FIT)
        stiffness.update(travel, force, dt_s=DT_S, settings=FIT)
        assert softest <= response.share <= 1.0
        assert SOFTEST_CONTACT_N_M <= stiffness.k_N_m <= STIFFEST_N_M


@given(st.floats(15.0, 250.0), st.floats(200.0, 2e5))
def test_a_late_sample_has_the_gain_of_a_loop_with_that_period(rate_hz, k_N_m) -> None:
    """Samples at another rate than 250 Hz have gain and prediction of a cell of that rate."""
    rates = CELL.rates.model_copy(update={"control_hz": rate_hz})
    slower = AdaptiveSettings.of(CELL.model_copy(update={"rates": rates}))
    of_sample, of_cell = (
        gain_for([k_N_m] * 3, RULE, replace(each, softest_N_m=0.0), 1.0 / rate_hz)
        for each in (SETTINGS, slower)
    )
    for one, other in zip(of_sample, of_cell, strict=True):
        assert one == pytest.approx(other, rel=1e-9)
