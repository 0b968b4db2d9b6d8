"""Calibration manager: tare and change of calibration while the cell runs. Pure.

Both are accepted only at rest, without force feedback, and where they cannot hide contact.
"""

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from common.config.cell import CellConfig
from common.config.payload import Payload, residual
from common.motion.convert import pose_of
from common.motion.frames import Array, rotation_between
from forcemesh.errors import DataError
from forcemesh.faults import refusal
from forcemesh.messages import RobotState
from forcemesh.requests import Reply
from services.wrench.active_calibration import (
    ActiveCalibration,
    active_calibration,
    initial_calibration,
    parse_calibration,
)
from services.wrench.compensation import Mounting
from services.wrench.plausibility import NO_FAULT, WrenchFault
from services.wrench.tare import TareLimits, tare

WINDOW_S = 0.25
REST_POSITION_M = 2e-4  # the flange moved less than this during the window: at rest
REST_TURN_RAD = 2e-3  # the same for its orientation: an error of 2 g per kilogram


class RequestContext(NamedTuple):
    """Inputs at the time of a request."""

    fault: WrenchFault  # of the inputs
    robot: RobotState | None
    feedback_runs: bool


class CalibrationManager:
    """Active calibration, changed on request or refused with a reason."""

    def __init__(self, cell: CellConfig, mounting: Mounting) -> None:
        """Start with the calibration of the cell, or with the payload of its file."""
        self.in_use: ActiveCalibration = initial_calibration(cell)
        self._cell = cell
        self._mounting = mounting
        self._limits = TareLimits(cell.force.tare_max_N, cell.force.tare_max_Nm)
        window = round(WINDOW_S * cell.rates.sensor_hz)
        self._recent: deque[tuple[Array, RobotState]] = deque(maxlen=window)

    def add(self, reading: Array, robot: RobotState) -> None:
        """Store a reading in sensor axes, shape (6,), with the state of the robot."""
        self._recent.append((reading, robot))

    def clear(self) -> None:
        """Clear the window after a gap or a fault."""
        self._recent.clear()

    def tare(self, context: RequestContext) -> Reply:
        """Take the present reading as zero."""
        robot = context.robot
        refused = self._refusal(context)
        if refused is not None or robot is None:
            return refused or refusal("invalid", "no pose")
        readings = [reading for reading, _ in self._recent]
        R = self._R_base_sensor(robot)
        payload, reply = tare(self.in_use.payload, readings, R, self._limits)
        if reply.accepted:
            self.in_use = self.in_use.with_bias_of(payload)
        return reply

    def calibrate(self, context: RequestContext, text: str) -> Reply:
        """Activate another calibration if it explains the present reading.

        Args:
            moment: Inputs at the time of the request.
            text: The calibration as JSON.
        """
        try:
            found = parse_calibration(text)
        except DataError as error:
            return refusal("malformed", f"not a calibration: {error}"[:400])
        new = active_calibration(found, self._cell)
        if new.objection:
            return refusal("payload", new.objection)
        robot = context.robot
        refused = self._refusal(context)
        if refused is not None or robot is None:
            return refused or refusal("invalid", "no pose")
        force_N, torque_Nm = self._residual(new.payload, robot)
        if (refused := self._too_much(found.revision, force_N, torque_Nm)) is not None:
            return refused
        self.in_use = new
        text = f"calibration {found.revision} is in use: residual {force_N:.2f} N and "
        return Reply(accepted=True, text=f"{text}{torque_Nm:.3f} N m of the present reading")

    def _residual(self, payload: Payload, robot: RobotState) -> tuple[float, float]:
        """Return the residual force [N] and torque about the TCP [N m] of the present reading."""
        mean = np.mean([reading for reading, _ in self._recent], axis=0)
        residual_N, residual_Nm = residual(
            payload, self._R_base_sensor(robot), force_N=mean[:3], torque_Nm=mean[3:]
        )
        about_tcp_Nm = residual_Nm - np.cross(self._mounting.p_sensor_tcp_in_sensor, residual_N)
        return float(np.linalg.norm(residual_N)), float(np.linalg.norm(about_tcp_Nm))

    def _too_much(self, revision: str, force_N: float, torque_Nm: float) -> Reply | None:
        """Refuse a payload whose residual exceeds the preflight limits for free space."""
        most_N, most_Nm = self._cell.force.idle_max_N, self._cell.force.idle_max_Nm
        if force_N <= most_N and torque_Nm <= most_Nm:
            return None
        text = (
            f"calibration {revision} leaves {force_N:.1f} N and {torque_Nm:.2f} N m about the TCP "
            "of the present reading: the tool is in contact, or another tool is mounted"
        )
        value, limit = (force_N, most_N) if force_N > most_N else (torque_Nm, most_Nm)
        return refusal("contact", text, value=value, limit=limit)

    def axes_checked(self, calibration: str) -> Reply:
        """Record that axes and signs were verified with a calibration."""
        if calibration != self.in_use.name:
            text = (
                f"axes were checked with calibration {calibration!r}, but {self.in_use.name!r} is "
                "in use: check them again"
            )
            return refusal("payload", text)
        self.in_use = replace(self.in_use, axes_checked=True)
        text = f"axes and signs are verified for calibration {self.in_use.name}"
        return Reply(accepted=True, text=text)

    def _refusal(self, context: RequestContext) -> Reply | None:
        if context.fault != NO_FAULT or context.robot is None:
            return refusal(context.fault.code, context.fault.text)
        if context.feedback_runs:
            return refusal("busy", "force feedback is running: stop it first")
        if len(self._recent) < (self._recent.maxlen or 1):
            return refusal("wait", "not enough samples yet: repeat the request")
        return self._motion(context.robot)

    def _motion(self, robot: RobotState) -> Reply | None:
        """Refuse when the flange moved or turned during the window."""
        poses = [pose_of(state) for _, state in self._recent]
        moved_m = float(np.max(np.ptp([T.translation for T in poses], axis=0)))
        rotations = [rotation_between(poses[-1].rotation, T.rotation) for T in poses]
        turned_rad = max(float(np.linalg.norm(rotation)) for rotation in rotations)
        value, limit = moved_m, REST_POSITION_M
        if moved_m <= limit and turned_rad > REST_TURN_RAD:
            value, limit = turned_rad, REST_TURN_RAD
        if value <= limit and not robot.status.moving:
            return None
        text = (
            f"the arm moved {moved_m * 1e3:.2f} mm and turned {np.degrees(turned_rad):.2f} degrees "
            f"within {WINDOW_S:g} s: wait until it is at rest"
        )
        return refusal("moving", text, value=value, limit=limit)

    def _R_base_sensor(self, robot: RobotState) -> Array:
        return np.asarray((pose_of(robot) * self._mounting.T_flange_sensor).rotation)
