"""Synthetic recordings of a known payload, for the tests of its identification."""

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from common.config.payload import Payload
from common.motion.frames import R_from_quaternion, rotation_from_vector
from common.motion.weight import predict, residual
from identification.recording import Samples, WrenchRecording

TRUTH = Payload(
    mass_kg=1.5,
    com_m=(0.02, -0.012, 0.085),
    bias_force_N=(1.0, -2.0, 3.0),
    bias_torque_Nm=(0.1, 0.2, -0.3),
)
FORCE_NOISE_N, TORQUE_NOISE_NM = 0.007, 0.00035
QUICK = settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

seeds = st.integers(0, 2**32 - 1)


def attitudes(rng, n):
    """Return n uniformly random rotations."""
    q = rng.normal(size=(n, 4))
    return np.array([R_from_quaternion(row / np.linalg.norm(row)) for row in q])


def readings(payload, R, rng=None):
    """Return the readings of a sensor, with noise when there is a generator for it."""
    force, torque = predict(payload, R)
    if rng is not None:
        force = force + FORCE_NOISE_N * rng.normal(size=force.shape)
        torque = torque + TORQUE_NOISE_NM * rng.normal(size=torque.shape)
    return Samples(R, force, torque)


def as_recording(samples, wrench_axes):
    """Return a recording of the samples with its wrench in the given axes."""
    turn = {
        "sensor": lambda v: v,
        "base": lambda v: np.einsum("nij,nj->ni", samples.R_base_sensor, v),
    }
    n = len(samples)
    return WrenchRecording(
        source="made.csv",
        line=tuple(range(2, n + 2)),
        time_s=np.arange(n, dtype=float),
        position_m=np.zeros((n, 3)),
        R_base_sensor=samples.R_base_sensor,
        force_N=turn[wrench_axes](samples.force_N),
        torque_Nm=turn[wrench_axes](samples.torque_Nm),
    )


def tilted(angle_deg, rng, payload=TRUTH):
    """Return the payload on a base that is tilted in a random direction."""
    heading = rng.uniform(0.0, 2.0 * np.pi)
    lean = np.radians(angle_deg) * np.array([np.cos(heading), np.sin(heading), 0.0])
    down = rotation_from_vector(lean) @ np.array([0.0, 0.0, -1.0])
    return Payload(
        mass_kg=payload.mass_kg,
        com_m=payload.com_m,
        bias_force_N=payload.bias_force_N,
        bias_torque_Nm=payload.bias_torque_Nm,
        gravity_direction_in_base=tuple(down),
        mounting_rotation_rad=payload.mounting_rotation_rad,
    )


def mounted(angle_deg, rng):
    """Return the payload on a sensor that is rotated about a random axis."""
    axis = rng.normal(size=3)
    turn = np.radians(angle_deg) * axis / np.linalg.norm(axis)
    return TRUTH.model_copy(update={"mounting_rotation_rad": tuple(turn.tolist())})  # of any size


def worst_error(found, truth, rng):
    """Return the largest error of force and torque over unseen attitudes."""
    force, torque = residual(
        found,
        (R := attitudes(rng, 100)),
        force_N=predict(truth, R)[0],
        torque_Nm=predict(truth, R)[1],
    )
    return np.linalg.norm(force, axis=1).max(), np.linalg.norm(torque, axis=1).max()
