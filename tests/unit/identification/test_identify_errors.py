"""Payload identification: errors of sensor and cell are identified where the data show them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.payload import (
    WORLDS,
    CellErrors,
    compared,
    plain_fit,
    read,
    recording,
    trial,
    truth,
)
from common.config.payload import BiasDrift
from common.motion.frames import R_from_quaternion
from common.motion.weight import bias_since_end, residual
from identification.excitation.pose_choice import next_pose
from identification.identify import identify_payload
from identification.least_squares import solve
from identification.payload_model import (
    Model,
    jacobian,
    residuals,
    start_state,
    updated_state,
)
from identification.recording import Poses, Samples
from tests.fakes.weights import QUICK, TRUTH, attitudes, readings, seeds

ALL = Model(tilt=True, mounting=True, gain=True, drift=2)


@QUICK
@given(seed=seeds)
def test_every_derivative_is_that_of_the_residual(seed):
    """A small step of any unknown, from any state, changes the residual by minus J times it."""
    rng = np.random.default_rng(seed)
    samples = readings(TRUTH, attitudes(rng, 5), rng)
    samples = replace(samples, time_s=np.sort(rng.uniform(0.0, 100.0, 5)))
    far = np.concatenate([rng.normal(size=10), rng.uniform(-0.4, 0.4, ALL.size - 10)])
    state = updated_state(start_state(), far, ALL)
    step = 1e-6 * rng.normal(size=ALL.size)
    change = residuals(updated_state(state, step, ALL), samples) - residuals(state, samples)
    np.testing.assert_allclose(change, -jacobian(state, samples, ALL) @ step, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in WORLDS if name != "no error"])
@pytest.mark.parametrize("poses", [6, 10, 20])
def test_with_a_model_error_at_most_seven_tenths_of_the_least_squares_error_remain(name, poses):
    """Mean over a few random recordings, for force and torque at poses outside the fit."""
    found, _ = compared(WORLDS[name], poses, 3)
    assert (found["ours"].mean(axis=0) <= 0.7 * found["LSM-short"].mean(axis=0)).all()


@pytest.mark.parametrize("poses", [6, 10, 20])
def test_without_a_model_error_none_is_fitted(poses):
    """At most three per cent above plain least squares."""
    found, _ = compared(CellErrors(), poses, 5)
    assert (found["ours"].mean(axis=0) <= 1.03 * found["LSM-short"].mean(axis=0)).all()


def test_standard_deviations_are_correct_also_for_tilt_and_mounting():
    """Of 12 recordings' 180 numbers, 88 to 99 per cent are within two standard deviations."""
    found = [trial(CellErrors(1.0, 1.0), seed)[1] for seed in range(12)]
    z = np.concatenate([np.concatenate(list(numbers.values())) for numbers in found])
    assert 0.88 < np.mean(np.abs(z) < 2.0) < 0.99


@settings(QUICK, max_examples=4)
@given(seed=seeds)
def test_the_leave_one_out_error_equals_that_of_a_fit_without_the_pose(seed):
    """The formula with the hat matrix gives the same as a fit without the pose."""
    rng = np.random.default_rng(seed)
    train, _ = recording(truth(WORLDS["all of them"], rng), 10, 0, rng)
    poses = Poses(train, np.ones(10), np.arange(10))
    left_out = solve(poses, Model(), start_state()).loo_residual
    for pose in range(10):
        without = plain_fit(train[np.setdiff1d(np.arange(10), [pose])])
        found = residual(
            without,
            train.R_base_sensor[pose],
            force_N=train.force_N[pose],
            torque_Nm=train.torque_Nm[pose],
        )
        np.testing.assert_allclose(left_out[:, pose], found, atol=1e-5)


def test_a_curved_drift_is_identified():
    """A warm-up drift is distinguished from a linear one, and explains the earlier readings."""
    rng = np.random.default_rng(5)
    curved = BiasDrift(
        start_s=0.0,
        end_s=600.0,
        force_N=(3.0, -2.0, 1.0),
        torque_Nm=(0.1, 0.05, -0.1),
        force_bend_N=(1.0, -0.6, 0.5),
    )
    train, others = recording(
        truth(CellErrors(), rng).model_copy(update={"drift": curved}), 12, 40, rng
    )
    found = identify_payload(train)
    assert found.chosen.model.name == "curved drift"
    force, _ = residual(
        found.payload,
        others.R_base_sensor,
        force_N=others.force_N,
        torque_Nm=others.torque_Nm,
        time_s=others.time_s,
    )
    assert np.linalg.norm(force, axis=1).mean() < 0.05


def test_the_bias_is_the_one_at_the_end_of_the_recording():
    """Later measurements need the newest bias, not the mean one."""
    rng = np.random.default_rng(8)
    real = truth(WORLDS["drift 1 N, 50 mNm"], rng)
    R, time_s = attitudes(rng, 12), np.linspace(0.0, 600.0, 12)
    found = identify_payload(read(real, R, time_s, rng))
    np.testing.assert_allclose(found.payload.bias_force_N, real.bias_force_N, atol=0.03)
    assert found.payload.drift is not None
    assert real.drift is not None
    np.testing.assert_allclose(found.payload.drift.force_N, real.drift.force_N, atol=0.05)


@given(st.floats(0.0, 600.0))
def test_after_the_recording_a_drift_continues_for_half_its_duration_then_stays_constant(ahead_s):
    """Zero at the end, then linear, at most half of the drift again."""
    drift = BiasDrift(
        start_s=0.0,
        end_s=600.0,
        force_N=(3.0, 0.0, 0.0),
        torque_Nm=(0.0, 0.3, 0.0),
        force_bend_N=(1.0, 0.0, 0.0),
    )
    force, torque = bias_since_end(drift, np.array([600.0, 600.0 + ahead_s]))
    assert force[0] == pytest.approx(np.zeros(3))
    assert force[1, 0] == pytest.approx(3.0 * min(ahead_s / 600.0, 0.5))
    assert torque[1, 1] == pytest.approx(0.3 * min(ahead_s / 600.0, 0.5))


def test_without_time_stamps_no_drift_is_fitted():
    """Readings without time, or all of one time, cannot show a drift."""
    samples = readings(TRUTH, attitudes(np.random.default_rng(2), 8))
    for time_s in (None, np.full(8, 3.0)):
        models = [c.model for c in identify_payload(replace(samples, time_s=time_s)).candidates]
        assert not any(model.drift for model in models)


def test_a_gain_common_to_all_axes_is_called_undetermined():
    """A sensor that reads 3 % more and a heavier tool give the same readings."""
    rng = np.random.default_rng(3)
    found = identify_payload(
        read(truth(WORLDS["gain 3 %"], rng), attitudes(rng, 12), np.arange(12.0), rng)
    )
    assert found.chosen.model.gain
    assert found.std.mass_kg > 0.01 * TRUTH.mass_kg
    assert any(line.startswith("torque_gain") for line in found.undetermined)
    gain = next(p for p in found.parameters if p.name == "force_gain.x")
    bias = next(p for p in found.parameters if p.name == "bias_force_N.x")
    assert gain.amplified > 3.0 * bias.amplified >= 3.0


@settings(QUICK, max_examples=4)
@given(seed=seeds, poses=st.integers(5, 10))
def test_the_advised_pose_reduces_the_deviation_as_announced(seed, poses):
    """With the advised attitude in the same fit, the deviation falls to what was announced."""
    rng = np.random.default_rng(seed)
    train, _ = recording(truth(CellErrors(), rng), poses, 0, rng)
    solution = identify_payload(train).chosen.solution
    advice = next_pose(solution)
    R = R_from_quaternion(advice.quaternion)[None]
    more = Samples(
        np.concatenate([train.R_base_sensor, R]),
        np.concatenate([train.force_N, np.zeros((1, 3))]),
        np.concatenate([train.torque_Nm, np.zeros((1, 3))]),
    )
    noise = np.array([solution.noise.force_N, solution.noise.torque_Nm])
    J = jacobian(solution.state, more, solution.model) / noise[:, None, None, None]
    J = J.reshape(-1, solution.model.size)
    std = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    assert solution.model == Model()
    assert np.min(np.abs(std - advice.std_after)) < 1e-6 * advice.std_after
    assert advice.std_after < advice.std_before
