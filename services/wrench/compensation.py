"""Tasks a and b of the specification: sensor reading to wrench of the environment. Pure.

With R = R_base_sensor and g_s = R^T g, the load that a real sensor shows free of contact is
m g_s + b_F and c x m g_s + b_M. What is left of a reading is the environment's:

    F = R (f - b_F - m g_s)
    M = R (t - b_M - c x m g_s) - (R p_sensor_tcp) x F

in base axes, with the sensor's own axes turned by the mounting correction that a recording may
have revealed; the moment about the tool centre point. Turning the axes does not move the point
that the moment is taken about, and moving the pose by the whole T_base_sensor would take it
about the base's origin: both steps are needed, and no third one.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.frames import Array, rotation_from_vector, skew
from common.payload import Payload, residual


@dataclass(frozen=True, slots=True)
class Wrench:
    """Force [N] and torque [N m]; the name of the variable says point and axes."""

    force_N: Array
    torque_Nm: Array


@dataclass(frozen=True, slots=True)
class Mounting:
    """Where sensor and tool sit on the flange."""

    T_flange_sensor: pin.SE3
    T_flange_tcp: pin.SE3

    @property
    def p_sensor_tcp_in_sensor(self) -> Array:
        """Vector from the sensor's origin to the TCP, sensor axes [m]. Shape (3,)."""
        return np.asarray((self.T_flange_sensor.inverse() * self.T_flange_tcp).translation)


def compensate(
    reading_at_sensor_in_sensor: Wrench,
    *,
    R_base_sensor: Array,
    p_sensor_tcp_in_sensor: Array,
    payload: Payload,
) -> Wrench:
    """Return the environment's wrench about the TCP, in base axes.

    Args:
        reading_at_sensor_in_sensor: What the sensor shows, about its origin, in its axes.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3).
        p_sensor_tcp_in_sensor: Vector from sensor to TCP, sensor axes [m]. Shape (3,).
        payload: Weight below the sensor and the sensor's bias.
    """
    R_mount = rotation_from_vector(np.asarray(payload.mounting_rotation_rad))
    R_base_true = R_base_sensor @ R_mount
    p_sensor_tcp_in_true = R_mount.T @ p_sensor_tcp_in_sensor
    force_N, torque_Nm = residual(
        payload,
        R_base_sensor,
        force_N=reading_at_sensor_in_sensor.force_N,
        torque_Nm=reading_at_sensor_in_sensor.torque_Nm,
    )
    torque_Nm = torque_Nm - skew(p_sensor_tcp_in_true) @ force_N
    return Wrench(R_base_true @ force_N, R_base_true @ torque_Nm)
