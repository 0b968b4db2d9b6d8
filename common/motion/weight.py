"""Weight of a payload: the readings that it causes, and what they leave of a reading. Pure."""

import numpy as np

from common.config.payload import BiasDrift, Payload
from common.motion.frames import GRAVITY_M_S2, Array, rotation_from_vector

REACH = 1.0  # validity of the drift beyond the recording, in lengths of the recording


def predict(payload: Payload, R_base_sensor: Array) -> tuple[Array, Array]:
    """Return force [N] and torque [Nm] that the sensor reads at rest and without contact.

    F = k_F m g_s + b_F and M = k_M (c x m g_s) + b_M, gains k axis by axis: the load on the sensor,
    about its origin, in its axes (Kubus, Kroeger, Wahl: On-line rigid object recognition and pose
    estimation, IROS 2007).

    Args:
        payload: Payload of the sensor.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
    """
    force, torque = weight_in_sensor(payload, R_base_sensor)
    return (
        np.array(payload.force_gain) * force + np.array(payload.bias_force_N),
        np.array(payload.torque_gain) * torque + np.array(payload.bias_torque_Nm),
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
    payload: Payload,
    R_base_sensor: Array,
    *,
    force_N: Array,
    torque_Nm: Array,
    time_s: Array | None = None,
) -> tuple[Array, Array]:
    """Return true load minus weight, in sensor axes: load of the environment, or the residual.

    Args:
        payload: Payload of the sensor.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3) or (n, 3, 3).
        force_N: Reading in sensor axes. Shape (3,) or (n, 3).
        torque_Nm: Reading in sensor axes, about the sensor origin. Shape (3,) or (n, 3).
        time_s: Times of the readings on the clock of the fit, to apply its drift. Shape (n,).
    """
    force, torque = weight_in_sensor(payload, R_base_sensor)
    b_F, b_M = np.array(payload.bias_force_N), np.array(payload.bias_torque_Nm)
    if payload.drift is not None and time_s is not None:
        d_F, d_M = bias_since_end(payload.drift, time_s)
        b_F, b_M = b_F + d_F, b_M + d_M
    return (
        (force_N - b_F) / np.array(payload.force_gain) - force,
        (torque_Nm - b_M) / np.array(payload.torque_gain) - torque,
    )


def drift_covers(drift: BiasDrift, time_s: Array) -> bool:
    """Return whether readings were taken near the recording of a drift, on the same clock."""
    reach = REACH * (drift.end_s - drift.start_s)
    return bool(time_s.min() >= drift.start_s - reach and time_s.max() <= drift.end_s + reach)


def bias_since_end(drift: BiasDrift, time_s: Array) -> tuple[Array, Array]:
    """Return the bias at each time relative to that at the end. Shapes (n, 3).

    Outside the recording the linear part is extrapolated over half its length, then the bias is
    constant: a warm-up slows down, and a random walk has no direction. The bend is not
    extrapolated.
    """
    u = 2.0 * (time_s - drift.start_s) / (drift.end_s - drift.start_s) - 1.0
    change = ((np.clip(u, -2.0, 2.0) - 1.0) / 2.0)[:, None]
    bend = (np.clip(u, -1.0, 1.0) ** 2 - 1.0)[:, None]
    return (
        change * np.array(drift.force_N) + bend * np.array(drift.force_bend_N),
        change * np.array(drift.torque_Nm) + bend * np.array(drift.torque_bend_Nm),
    )
