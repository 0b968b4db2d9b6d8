"""Payload identification: errors of sensor and cell are identified, unusable rows are left out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bench.payload import (
    WORLDS,
    CellErrors,
    attitudes,
    compared,
    plain_fit,
    read,
    recording,
    trial,
    truth,
)
from common.motion.frames import rotation_from_vector
from common.motion.weight import residual
from forcemesh.errors import DataError
from identification.identify import identify_payload, identify_recording
from identification.payload_fit import (
    SIZE,
    Directions,
    jacobian,
    predicted,
    solve,
)
from identification.recording import Poses
from identification.static_poses import CONTACT, MOVING, SINGLE_RAD, STALE, angle, screen_samples
from tests.fakes.weights import QUICK, TRUTH, as_recording, readings, seeds


@QUICK
@given(seed=seeds)
def test_every_derivative_is_that_of_the_prediction(seed) -> None:
    """A small step of any unknown, from any state, changes the prediction by J times it."""
    rng = np.random.default_rng(seed)
    samples = readings(TRUTH, attitudes(rng, 5), rng)
    samples = replace(samples, time_s=np.sort(rng.uniform(0.0, 100.0, 5)))
    x = np.concatenate([rng.normal(size=10), rng.uniform(-0.4, 0.4, SIZE - 10)])
    directions = Directions().turned(x)
    step = 1e-6 * rng.normal(size=SIZE)
    moved = predicted(x + step, samples, directions.turned(step))
    change = moved - predicted(x, samples, directions)
    np.testing.assert_allclose(change, jacobian(x, samples, directions) @ step, atol=1e-9)


UNCHANGED = 1.03  # at most this share of the error of plain least squares, where that is right
MOST = {"no error": (UNCHANGED, UNCHANGED), "gain 3 %": (0.7, UNCHANGED)}  # force, torque


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("poses", [6, 20])
def test_at_most_seven_tenths_of_the_least_squares_error_remain(name, poses) -> None:
    """Mean over a few random recordings, for force and torque at poses outside the fit."""
    found, _ = compared(WORLDS[name], poses, 5 if name == "no error" else 3)
    most = np.array(MOST.get(name, (0.7, 0.7)))
    assert (found["ours"].mean(axis=0) <= most * found["LSM-short"].mean(axis=0)).all()


def test_standard_deviations_are_correct_also_for_tilt_and_mounting() -> None:
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
    left_out = solve(poses, (), Directions()).left_out
    for pose in range(10):
        without = plain_fit(train[np.setdiff1d(np.arange(10), [pose])])
        found = residual(
            without,
            train.R_base_sensor[pose],
            force_N=train.force_N[pose],
            torque_Nm=train.torque_Nm[pose],
        )
        np.testing.assert_allclose(left_out[:, pose], found, atol=1e-5)


@pytest.mark.parametrize("course", [lambda u: u, lambda u: 1.0 - np.exp(-3.0 * u), np.sqrt])
def test_a_drift_is_refused_with_its_size_and_the_remedy(course) -> None:
    """Straight or a warm-up, with other errors as well; a small one is left in the residual."""
    rng = np.random.default_rng(5)
    time_s = np.linspace(0.0, 600.0, 12)
    samples = read(truth(WORLDS["all of them"], rng), attitudes(rng, 12), time_s, rng)
    drift = course(time_s / 600.0)[:, None]
    small = samples.force_N + 0.1 * drift * np.array([0.0, 0.0, 1.0])
    identify_payload(replace(samples, force_N=small))
    large = replace(samples, force_N=samples.force_N + drift * np.array([0.0, 1.0, -1.5]))
    with pytest.raises(DataError, match=r"bias .* drifted by 1\.\d.* within 600 s.*warm up"):
        identify_payload(large)


def test_a_drift_is_refused_in_the_axes_of_the_wrench() -> None:
    """The other axes, in which the recording is no weight, are not taken for the right ones."""
    rng = np.random.default_rng(8)
    samples = read(TRUTH, attitudes(rng, 10), 60.0 * np.arange(10.0), rng, drift=3.0)
    for axes in ("sensor", "base"):
        with pytest.raises(DataError, match=r"made\.csv: the bias of the sensor drifted"):
            identify_recording(as_recording(samples, axes), None)


def test_a_centre_of_mass_out_of_reach_is_refused() -> None:
    """Torques in the columns of the forces give one metres away."""
    samples = readings(TRUTH, attitudes(np.random.default_rng(4), 10))
    with pytest.raises(DataError, match=r"centre of mass would be .* m .*check axes"):
        identify_payload(replace(samples, force_N=samples.torque_Nm, torque_Nm=samples.force_N))


ROWS = 20


def dwells(rng, poses=8, rows=ROWS):
    """Return a recording at 50 Hz with `poses` poses of `rows` rows each and jumps between them.

    A smaller change from one row to the next would count as motion.
    """
    R = attitudes(rng, poses)
    while (angle(R[:-1], R[1:]) <= SINGLE_RAD).any():
        R = attitudes(rng, poses)
    R = np.repeat(R, rows, axis=0)
    return replace(readings(TRUTH, R, rng), time_s=np.arange(len(R)) / 50.0)


@QUICK
@given(seed=seeds, poses=st.integers(6, 12), rows=st.integers(1, 30))
@example(seed=141409, poses=9, rows=2)  # two consecutive attitudes are alike
def test_a_clean_recording_loses_no_row(seed, poses, rows):
    """Noise alone is never a reason, whatever the number of rows in a dwell."""
    screened, rejected = screen_samples(dwells(np.random.default_rng(seed), poses, rows))
    assert rejected == ()
    assert len(screened) <= poses


@QUICK
@given(seed=seeds, hit=st.integers(0, 7), push_N=st.floats(2.0, 50.0))
def test_a_pose_in_contact_is_left_out(seed, hit, push_N):
    """A push during all rows of one dwell contradicts the other dwells."""
    rng = np.random.default_rng(seed)
    samples = dwells(rng)
    rows = np.arange(hit * ROWS, (hit + 1) * ROWS)
    force = samples.force_N.copy()
    force[rows] += push_N * np.array([0.6, 0.0, 0.8])
    screened, rejected = screen_samples(replace(samples, force_N=force))
    assert [(r.reason, set(r.rows)) for r in rejected] == [(CONTACT, set(rows.tolist()))]
    assert len(screened) == 7


def test_a_pose_older_than_its_reading_is_stale():
    """The reading belongs to the next pose while the recorded pose is still the old one."""
    samples = dwells(np.random.default_rng(2))
    R = samples.R_base_sensor.copy()
    R[60:66] = R[59]
    screened, rejected = screen_samples(replace(samples, R_base_sensor=R))
    assert [(r.reason, r.rows) for r in rejected] == [(STALE, tuple(range(60, 66)))]
    assert identify_payload(replace(samples, R_base_sensor=R)).payload.mass_kg == pytest.approx(
        1.5, abs=0.01
    )
    assert len(screened) == 8


def swept(rng, poses=8):
    """Return dwells of 40 rows with 20 rows of steady turning between them, at 50 Hz."""
    R, moving = [], []
    turn = np.eye(3)
    for _ in range(poses):
        R += [turn] * 40
        moving += [False] * 40
        axis = rng.normal(size=3)
        step = rotation_from_vector(np.radians(4.0) * axis / np.linalg.norm(axis))
        for _ in range(20):
            turn = turn @ step
            R.append(turn)
            moving.append(True)
    samples = readings(TRUTH, np.array(R), rng)
    return replace(samples, time_s=np.arange(len(R)) / 50.0), np.array(moving)


@QUICK
@given(seed=seeds)
def test_rows_of_a_rotating_arm_are_left_out(seed):
    """Between the dwells the reading contains inertial forces: only rows at rest remain."""
    samples, moving = swept(np.random.default_rng(seed))
    _, rejected = screen_samples(samples)
    assert rejected[0].reason == MOVING
    assert set(np.flatnonzero(moving)) - {len(samples) - 1} <= set(rejected[0].rows)
    assert len(rejected[0].rows) < len(samples) / 2


def test_a_gain_common_to_all_axes_is_called_undetermined():
    """A sensor that reads 3 % more and a heavier tool give the same readings."""
    rng = np.random.default_rng(3)
    world = truth(WORLDS["gain 3 %"], rng)
    found = identify_payload(read(world, attitudes(rng, 12), np.arange(12.0), rng))
    assert found.chosen.name == "gain"
    assert np.max(found.std["mass_std_kg"]) > 0.01 * TRUTH.mass_kg


def test_a_touch_within_a_dwell_is_left_out_and_the_dwell_stays():
    """Five rows of twenty are in contact and left out; fifteen remain."""
    samples = dwells(np.random.default_rng(1))
    torque = samples.torque_Nm.copy()
    torque[45:50] += 0.5
    screened, rejected = screen_samples(replace(samples, torque_Nm=torque))
    assert [(r.reason, r.rows) for r in rejected] == [(CONTACT, tuple(range(45, 50)))]
    assert len(screened) == 8
