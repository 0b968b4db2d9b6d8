"""Choice of attitudes: greedy D-optimal design. Pure.

Each reading in attitude k adds J^T S^-1 J to the information on mass, moment, bias and, with the
priors of the fit, on tilt, mounting and gain. The next attitude is the one that increases the
determinant of the information most; the directions of gravity then spread over the sphere.
"""

import numpy as np

from common.config.payload import Payload
from common.motion.frames import Array
from identification.least_squares import plain_conditioning
from identification.next_pose import reference_sizes
from identification.payload_model import LINEAR, Model, jacobian, start_state
from identification.recording import Samples
from identification.static_poses import angle

FULL = Model(tilt=True, mounting=True, gain=True)
NOISE_N, NOISE_NM = 0.02, 0.001  # of the mean of a dwell, attitude errors included
APART_RAD = np.radians(20.0)  # nearer attitudes add little information
USUAL_PAYLOAD = Payload(
    mass_kg=1.0,
    com_m=(0.0, 0.0, 0.05),
    bias_force_N=(0.0, 0.0, 0.0),
    bias_torque_Nm=(0.0, 0.0, 0.0),
)


def best_attitudes(
    R_base_sensor: Array, payload: Payload, count: int, excluded: tuple[int, ...] = ()
) -> list[int]:
    """Return the indices of the attitudes to add, the most informative one first.

    Fewer than `count` are returned when the others are within 20 degrees of a chosen one.

    Args:
        R_base_sensor: Attitudes to choose from. Shape (n, 3, 3).
        payload: Approximate payload of the sensor.
        count: Number of attitudes to add.
        excluded: Indices of the attitudes that are chosen already.
    """
    J = _scaled_jacobians(R_base_sensor, payload)
    information = _prior(payload)
    is_distinct = np.ones(len(J), dtype=bool)
    for place in excluded:
        information = information + J[place].T @ J[place]
        is_distinct &= angle(R_base_sensor[place], R_base_sensor) > APART_RAD
    chosen: list[int] = []
    while len(chosen) < count and is_distinct.any():
        covariance = np.linalg.inv(information)
        gain = np.linalg.slogdet(np.eye(6) + J @ covariance @ J.swapaxes(1, 2))[1]
        best = int(np.argmax(np.where(is_distinct, gain, -np.inf)))
        chosen.append(best)
        information = information + J[best].T @ J[best]
        is_distinct &= angle(R_base_sensor[best], R_base_sensor) > APART_RAD
    return chosen


def fresh_attitudes(R_base_sensor: Array, count: int, excluded: tuple[int, ...]) -> list[int]:
    """Return the indices of attitudes farthest from those taken and from each other."""
    chosen: list[int] = []
    nearest = np.full(len(R_base_sensor), np.inf)
    for place in excluded:
        nearest = np.minimum(nearest, angle(R_base_sensor[place], R_base_sensor))
    while len(chosen) < count and nearest.max(initial=0.0) > APART_RAD / 2.0:
        best = int(np.argmax(nearest))
        chosen.append(best)
        nearest = np.minimum(nearest, angle(R_base_sensor[best], R_base_sensor))
    return chosen


def conditioning(R_base_sensor: Array) -> float:
    """Return the condition number of the linear fit of these attitudes. Shape (n, 3, 3)."""
    zeros = np.zeros((len(R_base_sensor), 3))
    return plain_conditioning(Samples(R_base_sensor, zeros, zeros), np.ones(len(zeros)))


def _scaled_jacobians(R_base_sensor: Array, payload: Payload) -> Array:
    """Return the derivatives of each reading, in units of its noise. Shape (n, 6, unknowns)."""
    state = start_state()
    state.linear[0] = payload.mass_kg
    state.linear[1:4] = payload.mass_kg * np.array(payload.com_m)
    zeros = np.zeros((len(R_base_sensor), 3))
    J = jacobian(state, Samples(R_base_sensor, zeros, zeros), FULL)
    J = J / np.array([NOISE_N, NOISE_NM])[:, None, None, None]
    return np.asarray(J.transpose(1, 0, 2, 3).reshape(len(R_base_sensor), 6, FULL.size))


def _prior(payload: Payload) -> Array:
    """Return the prior information, from the usual sizes of the parameters."""
    sizes = reference_sizes(FULL, payload.mass_kg)
    sizes[:LINEAR] *= 100.0
    return np.diag(1.0 / sizes**2)
