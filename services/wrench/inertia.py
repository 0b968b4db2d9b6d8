"""Inertial compensation: acceleration of the tool's centre of mass from reported poses. Pure.

A moving tool loads the sensor with m (g - a); compensating only m g leaves a force that reads as
contact. The acceleration is that of a parabola fitted to the last 2 h + 1 positions of the centre
of mass (Savitzky-Golay filter, 1964). It belongs to the middle of them, h periods ago; h is chosen
equal to the delay of the force filter, so that force and acceleration belong to the same time. The
load of the tool's own rotation, its moment of inertia times angular acceleration, is not known
from a payload and is not compensated.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from common.config.cell import CellConfig
from common.config.payload import Payload
from common.motion.convert import pose_of
from common.motion.frames import Array, rotation_from_vector
from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S
from forcemesh.messages import RobotState
from services.wrench.compensation import Mounting

AT_REST = np.zeros(3)
AT_REST.setflags(write=False)
PERIODS_MEASURED = 50  # window in which the robot's real period is measured


@dataclass(frozen=True, slots=True)
class ReportedPose:
    """Reported pose: sequence number, time of publication, position of the centre of mass."""

    seq: int
    epoch: int
    stamp_ns: int
    p_com_m: Array


class AccelerationEstimator:
    """Acceleration of the centre of mass, base axes; zero until enough poses came without a gap."""

    def __init__(self, cell: CellConfig, mounting: Mounting) -> None:
        """Choose the length of the parabola from the delay of the filter."""
        half = max(1, round(cell.filter_delay_s * cell.rates.robot_hz))
        offsets = np.arange(-half, half + 1, dtype=float)
        self._weights = 2.0 * np.linalg.pinv(np.vander(offsets, 3))[0]  # of the second derivative
        self._mounting = mounting
        self._reports: deque[ReportedPose] = deque(maxlen=max(len(offsets), PERIODS_MEASURED))

    def update(self, robot: Reading[RobotState], payload: Payload) -> None:
        """Store a new pose; a stale pose or a gap clears the window."""
        if robot.fresh is None or robot.header is None:
            self._reports.clear()
            return
        header = robot.header
        if self._reports:
            last = self._reports[-1]
            if (header.epoch, header.seq) == (last.epoch, last.seq):
                return
            if (header.epoch, header.seq) != (last.epoch, last.seq + 1):
                self._reports.clear()
        T = pose_of(robot.fresh) * self._mounting.T_flange_sensor
        R_mount = rotation_from_vector(np.array(payload.mounting_rotation_rad))
        p_com_m = np.asarray(T.act(R_mount @ np.array(payload.com_m)))
        self._reports.append(ReportedPose(header.seq, header.epoch, header.stamp_ns, p_com_m))

    def now(self) -> Array:
        """Return the acceleration [m/s^2], base axes. Shape (3,)."""
        count = len(self._weights)
        if len(self._reports) < count:
            return AT_REST
        first, last = self._reports[0], self._reports[-1]
        period_s = (last.stamp_ns - first.stamp_ns) / NS_PER_S / (last.seq - first.seq)
        if period_s <= 0.0:
            return AT_REST
        p = np.array([report.p_com_m for report in list(self._reports)[-count:]])
        return np.asarray(self._weights @ (p - p[-1]) / period_s**2)
