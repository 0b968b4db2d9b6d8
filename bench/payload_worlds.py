"""Simulated recordings of a known payload, with the errors of real cells."""

from dataclasses import dataclass

import numpy as np

from common.config.payload import DOWN, BiasDrift, Payload
from common.motion.convert import vec3
from common.motion.frames import Array, R_from_quaternion, rotation_from_vector
from common.motion.weight import bias_since_end, predict
from identification.recording import Samples
from identification.static_poses import carries_a_fit, sort_into_poses

NOISE_N, NOISE_NM = 0.1, 0.005  # of one sample
SAMPLES_PER_DWELL = 200  # averaged, as the wizard does
DURATION_S = 600.0
GAIN_ERROR = 0.03
DRIFT_N, DRIFT_NM = 1.0, 0.05  # over the recording, standard deviation of one axis

LEVEL = Payload(
    mass_kg=1.5,
    com_m=(0.02, -0.012, 0.085),
    bias_force_N=(1.0, -2.0, 3.0),
    bias_torque_Nm=(0.1, 0.2, -0.3),
)


@dataclass(frozen=True, slots=True)
class CellErrors:
    """Errors of the cell: tilt and mounting [degrees], gain and drift as multiples."""

    tilt_deg: float = 0.0
    mounting_deg: float = 0.0
    gain: float = 0.0
    drift: float = 0.0


WORLDS = {
    "no error": CellErrors(),
    "tilt 1 deg": CellErrors(tilt_deg=1.0),
    "mounting 1 deg": CellErrors(mounting_deg=1.0),
    "gain 3 %": CellErrors(gain=1.0),
    "drift 1 N, 50 mNm": CellErrors(drift=1.0),
    "all of them": CellErrors(1.0, 1.0, 1.0, 1.0),
}


def truth(world: CellErrors, rng: np.random.Generator) -> Payload:
    """Return the payload of one cell: errors of the given size, in random directions."""
    heading = rng.uniform(0.0, 2.0 * np.pi)
    axis = rng.normal(size=3)
    lean = np.radians(world.tilt_deg) * np.array([np.cos(heading), np.sin(heading), 0.0])
    gains = 1.0 + world.gain * GAIN_ERROR * rng.normal(size=(2, 3))
    drifts = world.drift * rng.normal(size=(2, 3)) * np.array([[DRIFT_N], [DRIFT_NM]])
    return Payload(
        mass_kg=LEVEL.mass_kg,
        com_m=LEVEL.com_m,
        bias_force_N=LEVEL.bias_force_N,
        bias_torque_Nm=LEVEL.bias_torque_Nm,
        gravity_direction_in_base=vec3(rotation_from_vector(lean) @ np.array(DOWN)),
        mounting_rotation_rad=vec3(np.radians(world.mounting_deg) * axis / np.linalg.norm(axis)),
        force_gain=vec3(gains[0]),
        torque_gain=vec3(gains[1]),
        drift=BiasDrift(
            start_s=0.0, end_s=DURATION_S, force_N=vec3(drifts[0]), torque_Nm=vec3(drifts[1])
        ),
    )


def attitudes(rng: np.random.Generator, n: int) -> Array:
    """Return n uniformly random rotations. Shape (n, 3, 3)."""
    return np.array([R_from_quaternion(q) for q in rng.normal(size=(n, 4))])


def read(payload: Payload, R: Array, time_s: Array, rng: np.random.Generator | None) -> Samples:
    """Return the mean reading of each dwell, noisy when there is a generator."""
    force, torque = predict(payload, R)
    if payload.drift is not None:
        d_F, d_M = bias_since_end(payload.drift, time_s)
        force, torque = force + d_F, torque + d_M
    if rng is not None:
        few = np.sqrt(SAMPLES_PER_DWELL)
        force = force + NOISE_N / few * rng.normal(size=force.shape)
        torque = torque + NOISE_NM / few * rng.normal(size=torque.shape)
    return Samples(R, force, torque, time_s)


def recording(
    payload: Payload, poses: int, others: int, rng: np.random.Generator
) -> tuple[Samples, Samples]:
    """Return a recording cut at random into training and other poses, both in order of time.

    Random poses that could not carry any fit are drawn again, as a wizard would.
    """
    n = poses + others
    while True:
        time_s = np.sort(rng.uniform(0.0, DURATION_S, n))
        samples = read(payload, attitudes(rng, n), time_s, rng)
        chosen = np.sort(rng.permutation(n)[:poses])
        train = samples[chosen]
        if carries_a_fit(sort_into_poses(train)):
            return train, samples[np.setdiff1d(np.arange(n), chosen)]
