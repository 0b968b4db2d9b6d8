"""Screening: rows that a fit must not use are left out, each with its reason."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bench.payload import attitudes
from common.motion.frames import rotation_from_vector
from identification.identify import identify_payload
from identification.static_poses import (
    CONTACT,
    MOVING,
    SINGLE_RAD,
    STALE,
    angle,
    screen_samples,
)
from tests.fakes.weights import QUICK, TRUTH, readings, seeds

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
