"""Calibration manager: tare and change of calibration while the cell runs. Pure.

Both are accepted only at rest, without force feedback, and where they cannot hide contact.
"""

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.config.payload import Payload
from common.motion.frames import Array, rotation_between
from common.motion.weight import residual
from forcemesh.errors import DataError
from forcemesh.faults import refusal
from forcemesh.requests import AxesRequest, CalibrationRequest, Empty, Reply
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

    now_ns: int
    fault: WrenchFault  # of the inputs
    T_base_flange: pin.SE3 | None  # None only with a fault
    moving: bool  # the robot reports motion
    feedback_runs: bool


class CalibrationManager:
    """Active calibration, changed on request or refused with a reason."""

    def __init__(self, cell: CellConfig, mounting: Mounting, now_ns: int) -> None:
        """Start with the calibration of the cell, or with the payload of its file."""
        self.in_use: ActiveCalibration = initial_calibration(cell)
        self.zero_since_ns = now_ns  # after a restart the age of the zero is unknown
        self._cell = cell
        self._mounting = mounting
        self._limits = TareLimits(cell.force.tare_max_N, cell.force.tare_max_Nm)
        # The last readings, sensor axes, shape (6,), with the pose of the flange; cleared by a gap.
        window = round(WINDOW_S * cell.rates.sensor_hz)
        self.recent: deque[tuple[Array, pin.SE3]] = deque(maxlen=window)

    def tare(self, context: RequestContext, _: Empty) -> Reply:
        """Take the present reading as zero."""
        if (refused := self._refusal(context)) is not None:
            return refused
        readings = [reading for reading, _ in self.recent]
        R = self._R_base_sensor(context)
        payload, reply = tare(self.in_use.payload, readings, R, self._limits)
        if reply.accepted:
            name = f"{self.in_use.origin}, tared"
            self.in_use = replace(self.in_use, payload=payload, name=name)
            self.zero_since_ns = context.now_ns
        return reply

    def calibrate(self, context: RequestContext, request: CalibrationRequest) -> Reply:
        """Activate another calibration if it explains the present reading."""
        try:
            found = parse_calibration(request.calibration_json)
        except DataError as error:
            return refusal("malformed", f"not a calibration: {error}"[:400])
        new = active_calibration(found, self._cell)
        if new.objection:
            return refusal("payload", new.objection)
        if (refused := self._refusal(context)) is not None:
            return refused
        force_N, torque_Nm = self._residual(new.payload, self._R_base_sensor(context))
        most_N, most_Nm = self._cell.force.idle_max_N, self._cell.force.idle_max_Nm
        if force_N > most_N or torque_Nm > most_Nm:
            text = (
                f"calibration {found.revision} leaves {force_N:.1f} N and {torque_Nm:.2f} N m "
                "about the TCP of the present reading: the tool is in contact, or another tool is "
                "mounted"
            )
            value, limit = (force_N, most_N) if force_N > most_N else (torque_Nm, most_Nm)
            return refusal("contact", text, value=value, limit=limit)
        self.in_use, self.zero_since_ns = new, context.now_ns  # its bias is new too
        text = f"calibration {found.revision} is in use: residual {force_N:.2f} N and "
        return Reply(accepted=True, text=f"{text}{torque_Nm:.3f} N m of the present reading")

    def axes_checked(self, _: RequestContext, request: AxesRequest) -> Reply:
        """Record that axes and signs were verified with a calibration."""
        if request.calibration != self.in_use.name:
            text = (
                f"axes were checked with calibration {request.calibration!r}, but "
                f"{self.in_use.name!r} is in use: check them again"
            )
            return refusal("payload", text)
        self.in_use = replace(self.in_use, axes_checked=True)
        text = f"axes and signs are verified for calibration {self.in_use.name}"
        return Reply(accepted=True, text=text)

    def _residual(self, payload: Payload, R_base_sensor: Array) -> tuple[float, float]:
        """Return the residual force [N] and torque about the TCP [N m] of the present reading."""
        mean = np.mean([reading for reading, _ in self.recent], axis=0)
        residual_N, residual_Nm = residual(
            payload, R_base_sensor, force_N=mean[:3], torque_Nm=mean[3:]
        )
        about_tcp_Nm = residual_Nm - np.cross(self._mounting.p_sensor_tcp_in_sensor, residual_N)
        return float(np.linalg.norm(residual_N)), float(np.linalg.norm(about_tcp_Nm))

    def _refusal(self, context: RequestContext) -> Reply | None:
        """Refuse with invalid inputs, with force feedback, and unless the flange is at rest."""
        if context.fault != NO_FAULT:
            return refusal(context.fault.code, context.fault.text)
        if context.feedback_runs:
            return refusal("busy", "force feedback is running: stop it first")
        if len(self.recent) < (self.recent.maxlen or 1):
            return refusal("wait", "not enough samples yet: repeat the request")
        poses = [T for _, T in self.recent]
        moved_m = float(np.max(np.ptp([T.translation for T in poses], axis=0)))
        rotations = [rotation_between(poses[-1].rotation, T.rotation) for T in poses]
        turned_rad = max(float(np.linalg.norm(rotation)) for rotation in rotations)
        value, limit = moved_m, REST_POSITION_M
        if moved_m <= limit and turned_rad > REST_TURN_RAD:
            value, limit = turned_rad, REST_TURN_RAD
        if value <= limit and not context.moving:
            return None
        text = (
            f"the arm moved {moved_m * 1e3:.2f} mm and turned {np.degrees(turned_rad):.2f} degrees "
            f"within {WINDOW_S:g} s: wait until it is at rest"
        )
        return refusal("moving", text, value=value, limit=limit)

    def _R_base_sensor(self, context: RequestContext) -> Array:
        return np.asarray((context.T_base_flange * self._mounting.T_flange_sensor).rotation)
