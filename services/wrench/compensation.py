"""Wrench of the environment at the TCP: filter of the readings, gravity and inertia. Pure.

Tasks a and b of the specification. With R = R_base_sensor and g_s = R^T g, a real sensor free of
contact reads m g_s + b_F and c x m g_s + b_M. The remainder is the environment's wrench:

    F = R (f - b_F - m g_s)
    M = R (t - b_M - c x m g_s - p_sensor_tcp x (f - b_F - m g_s))

in base axes, the moment about the tool centre point. Each axis of f - b_F is divided by its gain,
and the sensor's axes are rotated by the identified mounting correction. A rotation
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
from collections.abc import Sequence
from math import exp
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.config.payload import Payload
from common.motion.convert import vec3
from common.motion.frames import GRAVITY_M_S2, Array, true_sensor
from forcemesh.messages import ZERO3, Vec3

PERIODS_MEASURED = 50  # window in which the robot's real period is measured


class Filter:
    """Filter of six channels: median against spikes, then a first-order low-pass."""

    def __init__(self, median: int, lowpass_s: float) -> None:
        """Begin without samples; `median` is the length of its window, `lowpass_s` is T."""
        self._recent: deque[Sequence[float]] = deque(maxlen=median)
        self._lowpass_s = lowpass_s
        self.output: tuple[float, ...] | None = None  # None until the first sample

    def clear(self) -> None:
        """Forget all samples."""
        self._recent.clear()
        self.output = None

    def feed(self, sample: Sequence[float], dt_s: float) -> None:
        """Filter one more sample.

        y <- y + (1 - exp(-dt / T)) (median - y); the first sample passes unfiltered.

        Args:
            sample: Six numbers in one unit each.
            dt_s: Time since the last sample.
        """
        self._recent.append(sample)
        half = len(self._recent) // 2
        middle = tuple([sorted(channel)[half] for channel in zip(*self._recent, strict=True)])
        if self.output is None or self._lowpass_s == 0.0:
            self.output = middle
            return
        share = 1.0 - exp(-dt_s / self._lowpass_s)
        pairs = zip(self.output, middle, strict=True)
        self.output = tuple([y + share * (median - y) for y, median in pairs])


class Wrench(NamedTuple):
    """Force [N] and torque [N m]; the variable name gives point and axes."""

    force_N: Vec3
    torque_Nm: Vec3


class Compensation:
    """Compensation of one payload: the formulas above, with what is the same for every sample."""

    def __init__(self, payload: Payload, T_flange_sensor: pin.SE3, T_flange_tcp: pin.SE3) -> None:
        """Prepare the constants, in the axes of the true sensor."""
        self._T_flange_true = true_sensor(T_flange_sensor, payload.mounting_rotation_rad)
        self.p_flange_com_in_flange = self._T_flange_true.act(np.array(payload.com_m))
        self._p_tcp_m = self._T_flange_true.actInv(T_flange_tcp).translation.tolist()
        self._com_m, self._mass_kg = payload.com_m, payload.mass_kg
        self._g_m_s2 = [GRAVITY_M_S2 * part for part in payload.gravity_direction_in_base]
        self._bias = payload.bias_force_N + payload.bias_torque_Nm
        self._to_load = [1.0 / gain for gain in payload.force_gain] + [1.0] * 3

    def at_tcp(
        self,
        reading_at_sensor_in_sensor: Wrench,
        T_base_flange: pin.SE3,
        a_com_m_s2: Vec3 = ZERO3,
    ) -> Wrench:
        """Return the environment's wrench about the TCP, in base axes.

        Args:
            reading_at_sensor_in_sensor: Reading of the sensor, about its origin, in its axes.
            T_base_flange: Pose of the flange.
            a_com_m_s2: Acceleration of the centre of mass, base axes.
        """
        reading = reading_at_sensor_in_sensor
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (  # R_base_true
            T_base_flange * self._T_flange_true
        ).rotation.tolist()
        cx, cy, cz = self._com_m
        px, py, pz = self._p_tcp_m
        ax, ay, az = [g - a for g, a in zip(self._g_m_s2, a_com_m_s2, strict=True)]
        wx = self._mass_kg * (xx * ax + yx * ay + zx * az)
        wy = self._mass_kg * (xy * ax + yy * ay + zy * az)
        wz = self._mass_kg * (xz * ax + yz * ay + zz * az)
        values = zip(reading.force_N + reading.torque_Nm, self._bias, self._to_load, strict=True)
        fx, fy, fz, mx, my, mz = [(value - bias) * to_load for value, bias, to_load in values]
        fx, fy, fz = fx - wx, fy - wy, fz - wz
        mx -= cy * wz - cz * wy + py * fz - pz * fy
        my -= cz * wx - cx * wz + pz * fx - px * fz
        mz -= cx * wy - cy * wx + px * fy - py * fx
        return Wrench(
            (xx * fx + xy * fy + xz * fz, yx * fx + yy * fy + yz * fz, zx * fx + zy * fy + zz * fz),
            (xx * mx + xy * my + xz * mz, yx * mx + yy * my + yz * mz, zx * mx + zy * my + zz * mz),
        )


class ReportedPosition(NamedTuple):
    """Centre of mass at a report of the robot, base axes [m], with numbers of the header."""

    epoch: int
    seq: int
    stamp_ns: int
    p_com_m: Array


class AccelerationEstimator:
    """Acceleration of the centre of mass, base axes; zero until enough poses came without a gap."""

    def __init__(self, cell: CellConfig) -> None:
        """Choose the length of the parabola from the delay of the filter."""
        half = max(1, round(cell.plant.filter_delay_s * cell.rates.robot_hz))
        offsets = np.arange(-half, half + 1, dtype=float)
        self._weights = 2.0 * np.linalg.pinv(np.vander(offsets, 3))[0]  # of the second derivative
        length = max(len(offsets), PERIODS_MEASURED)
        self._reports: deque[ReportedPosition] = deque(maxlen=length)

    def update(self, report: ReportedPosition | None) -> None:
        """Store a new report; none or a gap clears the window."""
        if report is None:
            self._reports.clear()
            return
        if self._reports:
            last = self._reports[-1]
            if report[:2] == last[:2]:
                return
            if report[:2] != (last.epoch, last.seq + 1):
                self._reports.clear()
        self._reports.append(report)

    def now(self) -> Vec3:
        """Return the acceleration [m/s^2], base axes."""
        count = len(self._weights)
        if len(self._reports) < count:
            return ZERO3
        first, last = self._reports[0], self._reports[-1]
        period_s = (last.stamp_ns - first.stamp_ns) / 1e9 / (last.seq - first.seq)
        if period_s <= 0.0:
            return ZERO3
        p = np.array([report.p_com_m for report in list(self._reports)[-count:]])
        return vec3(self._weights @ (p - p[-1]) / period_s**2)
