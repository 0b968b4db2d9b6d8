"""Gravity compensation: wrench of the environment at the TCP from a sensor reading. Pure.

Tasks a and b of the specification. With R = R_base_sensor and g_s = R^T g, a real sensor free of
contact reads m g_s + b_F and c x m g_s + b_M. The remainder is the environment's wrench:

    F = R (f - b_F - m g_s)
    M = R (t - b_M - c x m g_s) - (R p_sensor_tcp) x F

in base axes, the moment about the tool centre point. Each axis of f - b_F and t - b_M is divided
by its gain, and the sensor's axes are rotated by the identified mounting correction. A rotation
of the axes does not move the reference point of the moment, and a transformation by the whole
T_base_sensor would move it to the base's origin: exactly these two steps are needed. In motion
the weight is m (g - a), if the acceleration is known.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from common.config.payload import Payload
from common.motion.frames import GRAVITY_M_S2, Array, rotation_from_vector


@dataclass(frozen=True, slots=True)
class Wrench:
    """Force [N] and torque [N m]; the variable name gives point and axes."""

    force_N: Array
    torque_Nm: Array


@dataclass(frozen=True, slots=True)
class Mounting:
    """Poses of sensor and tool on the flange."""

    T_flange_sensor: pin.SE3
    T_flange_tcp: pin.SE3

    @property
    def p_sensor_tcp_in_sensor(self) -> Array:
        """Vector from the sensor's origin to the TCP, sensor axes [m]. Shape (3,)."""
        return np.asarray((self.T_flange_sensor.inverse() * self.T_flange_tcp).translation)


@dataclass(frozen=True, slots=True)
class _Constants:
    """Constants of a payload for every sample; `to_load`: the reciprocals of the gains."""

    R_mount: Array
    weight_in_base_N: Array
    bias_N: Array
    bias_Nm: Array
    force_to_load: Array
    torque_to_load: Array
    com_m: Array


def compensate(
    reading_at_sensor_in_sensor: Wrench,
    *,
    R_base_sensor: Array,
    p_sensor_tcp_in_sensor: Array,
    payload: Payload,
    a_com_m_s2: Array | None = None,
) -> Wrench:
    """Return the environment's wrench about the TCP, in base axes.

    Args:
        reading_at_sensor_in_sensor: Reading of the sensor, about its origin, in its axes.
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3).
        p_sensor_tcp_in_sensor: Vector from sensor to TCP, sensor axes [m]. Shape (3,).
        payload: Weight below the sensor and the sensor's bias.
        a_com_m_s2: Acceleration of the centre of mass, base axes; None: at rest. Shape (3,).
    """
    known = _constants(payload)
    reading = reading_at_sensor_in_sensor
    R_base_true = R_base_sensor.dot(known.R_mount)
    load_N = R_base_true.dot((reading.force_N - known.bias_N) * known.force_to_load)
    load_Nm = R_base_true.dot((reading.torque_Nm - known.bias_Nm) * known.torque_to_load)
    weight_N = known.weight_in_base_N
    if a_com_m_s2 is not None:
        weight_N = weight_N - payload.mass_kg * a_com_m_s2
    force_N = load_N - weight_N
    # The sum of both moments in scalars: np.cross alone would cost more than the rest.
    cx, cy, cz = R_base_true.dot(known.com_m).tolist()
    px, py, pz = R_base_sensor.dot(p_sensor_tcp_in_sensor).tolist()
    wx, wy, wz = weight_N.tolist()
    fx, fy, fz = force_N.tolist()
    moved_Nm = np.array(
        [
            cy * wz - cz * wy + py * fz - pz * fy,
            cz * wx - cx * wz + pz * fx - px * fz,
            cx * wy - cy * wx + px * fy - py * fx,
        ]
    )
    return Wrench(force_N, load_Nm - moved_Nm)


@lru_cache(maxsize=4)
def _constants(payload: Payload) -> _Constants:
    down = np.array(payload.gravity_direction_in_base)
    return _Constants(
        R_mount=rotation_from_vector(np.array(payload.mounting_rotation_rad)),
        weight_in_base_N=payload.mass_kg * GRAVITY_M_S2 * down,
        bias_N=np.array(payload.bias_force_N),
        bias_Nm=np.array(payload.bias_torque_Nm),
        force_to_load=1.0 / np.array(payload.force_gain),
        torque_to_load=1.0 / np.array(payload.torque_gain),
        com_m=np.array(payload.com_m),
    )
