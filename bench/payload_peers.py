"""Published methods for payload and bias, for comparison: plain numpy, no priors, no model choice.

- `lsm`: mass, centre of mass and bias by least squares, force first (the short published method).
- `kth`: the same ten unknowns in one stacked 6 x 10 system, as in KTH's force_torque_tools. Its
  gravity comes from an accelerometer on the sensor; without one it is taken from the pose,
  as here. Force and torque share no unknown, so the result equals that of `lsm`.
- `lsm_tilt`: the weight as a free vector in base, mass and gravity's direction from it.
- `lsm_mounting`: a free 3 x 3 matrix in place of mass and mounting, its nearest rotation.
"""

from collections.abc import Callable

import numpy as np

from common.config.payload import DOWN, Payload
from common.motion.convert import vec3
from common.motion.frames import GRAVITY_M_S2, Array, vector_from_rotation
from identification.payload_model import skew_matrices
from identification.recording import Samples


def lsm(samples: Samples) -> Payload:
    """Return the plain fit: force, then torque."""
    return _given(samples, np.array(DOWN), np.eye(3))


def kth(samples: Samples) -> Payload:
    """Return the fit of all ten unknowns at once: rows [g 0 I 0] and [0 -[g]x 0 I]."""
    g_s = _gravity(samples, np.array(DOWN), np.eye(3))
    n = len(samples)
    H = np.zeros((n, 6, 10))
    H[:, :3, 0] = g_s
    H[:, 3:, 1:4] = -skew_matrices(g_s)
    H[:, :, 4:] = np.eye(6)
    z = np.hstack([samples.force_N, samples.torque_Nm]).ravel()
    x = np.asarray(np.linalg.lstsq(H.reshape(-1, 10), z, rcond=None)[0], dtype=np.float64)
    return _payload(x, np.array(DOWN), np.eye(3))


def lsm_tilt(samples: Samples) -> Payload:
    """Return the fit with free direction of gravity."""
    R_sensor_base = np.swapaxes(samples.R_base_sensor, 1, 2)
    weight = _linear(R_sensor_base, samples.force_N)
    return _given(samples, weight / np.linalg.norm(weight), np.eye(3))


def lsm_mounting(samples: Samples) -> Payload:
    """Return the fit with free mounting rotation of the sensor."""
    g_s = _gravity(samples, np.array(DOWN), np.eye(3))
    columns = np.einsum("ij,nk->nijk", np.eye(3), g_s).reshape(len(g_s), 3, 9)
    U, _, Vt = np.linalg.svd(_linear(columns, samples.force_N).reshape(3, 3))
    R_mount = (U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt).T
    return _given(samples, np.array(DOWN), R_mount)


PEERS: dict[str, Callable[[Samples], Payload]] = {
    "LSM-short": lsm,
    "with tilt": lsm_tilt,
    "with mounting": lsm_mounting,
    "KTH": kth,
}


def _given(samples: Samples, down_in_base: Array, R_mount: Array) -> Payload:
    """Return the plain fit with given directions."""
    g_s = _gravity(samples, down_in_base, R_mount)
    force = _with_bias(g_s[:, :, None], samples.force_N)
    torque = _with_bias(-skew_matrices(g_s), samples.torque_Nm)
    x = np.hstack([force[0], torque[:3], force[1:], torque[3:]])
    return _payload(x, down_in_base, R_mount)


def _payload(x: Array, down_in_base: Array, R_mount: Array) -> Payload:
    mass = max(float(x[0]), 1e-6)
    return Payload(
        mass_kg=mass,
        com_m=vec3(x[1:4] / mass),
        bias_force_N=vec3(x[4:7]),
        bias_torque_Nm=vec3(x[7:10]),
        gravity_direction_in_base=vec3(down_in_base),
        mounting_rotation_rad=vec3(vector_from_rotation(R_mount)),
    )


def _gravity(samples: Samples, down_in_base: Array, R_mount: Array) -> Array:
    R = samples.R_base_sensor @ R_mount
    return np.asarray(np.swapaxes(R, 1, 2) @ (GRAVITY_M_S2 * down_in_base))


def _linear(columns: Array, readings: Array) -> Array:
    return _with_bias(columns, readings)[: columns.shape[2]]


def _with_bias(columns: Array, readings: Array) -> Array:
    """Return x and b of readings = columns x + b by least squares. columns: (n, 3, k)."""
    n, _, k = columns.shape
    A = np.concatenate([columns, np.broadcast_to(np.eye(3), (n, 3, 3))], axis=2)
    return np.asarray(np.linalg.lstsq(A.reshape(-1, k + 3), readings.ravel(), rcond=None)[0])
