"""Wrench of the environment at the TCP: filter of the readings, gravity and inertia. Pure.

Tasks a and b of the specification. With R = R_base_sensor and g_s = R^T g, a real sensor free of
contact reads m g_s + b_F and c x m g_s + b_M. The remainder is the environment's wrench:

    F = R (f - b_F - m g_s)
    M = R (t - b_M - c x m g_s) - (R p_sensor_tcp) x F

in base axes, the moment about the tool centre point. Each axis of f - b_F and t - b_M is divided
by its gain, and the sensor's axes are rotated by the identified mounting correction. A rotation
of the axes does not move the reference point of the moment, and a transformation by the whole
T_base_sensor would move it to the base's origin: exactly these two steps are needed.

A moving tool loads the sensor with m (g - a); compensating only m g leaves a force that reads as
contact. The acceleration of the centre of mass is that of a parabola fitted to its last 2 h + 1
reported positions (Savitzky-Golay filter, 1964). It belongs to the middle of them, h periods ago;
h is chosen equal to the delay of the force filter, so that force and acceleration belong to the
same time. The load of the tool's own rotation, its moment of inertia times angular acceleration,
is not known from a payload and is not compensated.
"""

from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from math import exp
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.config.payload import Payload
from common.motion.frames import GRAVITY_M_S2, Array, rotation_from_vector

AT_REST = np.zeros(3)
AT_REST.setflags(write=False)
PERIODS_MEASURED = 50  # window in which the robot's real period is measured


@dataclass(frozen=True, slots=True)
class Filter:
    """State of the filter of six channels: median against spikes, then a first-order low-pass."""

    median: int
    lowpass_s: float
    recent: tuple[Array, ...] = ()
    output: Array | None = None  # None until the first sample


def feed(state: Filter, sample: Array, dt_s: float) -> Filter:
    """Return the filter after one more sample.

    y <- y + (1 - exp(-dt / T)) (median - y); the first sample passes unfiltered.

    Args:
        state: State of the filter.
        sample: Six numbers in one unit each. Shape (6,).
        dt_s: Time since the last sample.
    """
    recent = (*state.recent, sample)[-state.median :]
    middle = np.sort(recent, axis=0)[len(recent) // 2]
    if state.output is None:
        return Filter(state.median, state.lowpass_s, recent, middle)
    share = 1.0 if state.lowpass_s == 0.0 else 1.0 - exp(-dt_s / state.lowpass_s)
    output = state.output + share * (middle - state.output)
    return Filter(state.median, state.lowpass_s, recent, output)


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


class ReportedPose(NamedTuple):
    """Pose of the flange with the header of its report."""

    epoch: int
    seq: int
    stamp_ns: int
    T_base_flange: pin.SE3


class AccelerationEstimator:
    """Acceleration of the centre of mass, base axes; zero until enough poses came without a gap."""

    def __init__(self, cell: CellConfig, mounting: Mounting) -> None:
        """Choose the length of the parabola from the delay of the filter."""
        half = max(1, round(cell.filter_delay_s * cell.rates.robot_hz))
        offsets = np.arange(-half, half + 1, dtype=float)
        self._weights = 2.0 * np.linalg.pinv(np.vander(offsets, 3))[0]  # of the second derivative
        self._mounting = mounting
        length = max(len(offsets), PERIODS_MEASURED)
        self._reports: deque[tuple[ReportedPose, Array]] = deque(maxlen=length)

    def update(self, report: ReportedPose | None, payload: Payload) -> None:
        """Store a new pose; no pose or a gap clears the window."""
        if report is None:
            self._reports.clear()
            return
        if self._reports:
            last = self._reports[-1][0]
            if report[:2] == last[:2]:
                return
            if report[:2] != (last.epoch, last.seq + 1):
                self._reports.clear()
        T_base_sensor = report.T_base_flange * self._mounting.T_flange_sensor
        known = _constants(payload)
        p_com_m = np.asarray(T_base_sensor.act(known.R_mount @ known.com_m))
        self._reports.append((report, p_com_m))

    def now(self) -> Array:
        """Return the acceleration [m/s^2], base axes. Shape (3,)."""
        count = len(self._weights)
        if len(self._reports) < count:
            return AT_REST
        first, last = self._reports[0][0], self._reports[-1][0]
        period_s = (last.stamp_ns - first.stamp_ns) / 1e9 / (last.seq - first.seq)
        if period_s <= 0.0:
            return AT_REST
        p = np.array([p_com_m for _, p_com_m in list(self._reports)[-count:]])
        return np.asarray(self._weights @ (p - p[-1]) / period_s**2)
