"""Weight of a payload: the readings that it causes, and what they leave of a reading. Pure."""

import numpy as np

from common.config.payload import Payload
from common.motion.frames import GRAVITY_M_S2, Array, rotation_from_vector


def predict(payload: Payload, R_base_sensor: Array) -> tuple[Array, Array]:
    """Return force [N] and torque [Nm] that the sensor reads at rest and without contact.

    F = k m g_s + b_F and M = c x m g_s + b_M, gains k axis by axis: the load on the sensor, about
    its origin, in its axes (Kubus, Kroeger, Wahl: On-line rigid object recognition and pose
    estimation, IROS 2007).

    Args:
        payload: Payload of the sensor.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
    """
    force, torque = weight_in_sensor(payload, R_base_sensor)
    return (
        np.array(payload.force_gain) * force + np.array(payload.bias_force_N),
        torque + np.array(payload.bias_torque_Nm),
    )


def weight_in_sensor(payload: Payload, R_base_sensor: Array) -> tuple[Array, Array]:
    """Return weight and moment of the payload in the axes of the true sensor.

    g_s = (R_base_sensor R_mount)^T g.
    """
    R_mount = rotation_from_vector(np.array(payload.mounting_rotation_rad))
    g_in_base = GRAVITY_M_S2 * np.array(payload.gravity_direction_in_base)
    g_s = np.einsum("...ji,j->...i", R_base_sensor @ R_mount, g_in_base)
    weight = payload.mass_kg * np.asarray(g_s)
    return weight, np.cross(np.array(payload.com_m), weight)


def residual(
    payload: Payload, R_base_sensor: Array, *, force_N: Array, torque_Nm: Array
) -> tuple[Array, Array]:
    """Return true load minus weight, in sensor axes: load of the environment, or the residual.

    Args:
        payload: Payload of the sensor.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
        force_N: Reading in sensor axes. Shape (3,) or (n, 3).
        torque_Nm: Reading in sensor axes, about the sensor origin. Shape (3,) or (n, 3).
    """
    force, torque = weight_in_sensor(payload, R_base_sensor)
    return (
        (force_N - np.array(payload.bias_force_N)) / np.array(payload.force_gain) - force,
        torque_Nm - np.array(payload.bias_torque_Nm) - torque,
    )
