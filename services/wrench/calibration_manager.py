"""Calibration manager: tare and change of calibration while the cell runs. Pure.

Both are accepted only at rest, without force feedback, and where they cannot hide contact.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from math import hypot
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.config.payload import Payload
from common.motion.convert import vec3
from common.motion.frames import GRAVITY_M_S2, Array, rotation_between
from common.motion.weight import residual
from forcemesh.errors import DataError
from forcemesh.faults import refused, tripped
from forcemesh.messages import TOUCHING, ContactEvent, Trip
from forcemesh.requests import AxesRequest, CalibrationRequest, Empty, Reply
from services.wrench.active_calibration import (
    ActiveCalibration,
    active_calibration,
    initial_calibration,
    parse_calibration,
)
from services.wrench.compensation import Compensation, Wrench

WINDOW_S = 0.25
REST_POSITION_M = 2e-4  # the flange moved less than this during the window: at rest
REST_TURN_RAD = 2e-3  # the same for its orientation: an error of 2 g per kilogram
WEIGHT_SHARE = 0.6  # a wrong unit or sign removes 0.78 (pounds), 0.9 (kgf), 1.4 or 2 weights
LEAST_WEIGHT_N = 2.0  # drift can be as large as a smaller weight
FREE_FIRST = "move the tool into free space; if it hangs free, run `forcemesh calibrate --free`"


class RequestContext(NamedTuple):
    """Inputs at the time of a request."""

    now_ns: int
    fault: Trip | None  # of the inputs
    T_base_flange: pin.SE3 | None  # None only with a fault
    moving: bool  # the robot reports motion
    feedback_runs: bool
    contact: ContactEvent | None  # of the regulator, None without a fresh and valid one


class CalibrationManager:
    """Active calibration, changed on request or refused with a reason."""

    def __init__(self, cell: CellConfig, now_ns: int) -> None:
        """Start with the calibration of the cell, or with the payload of its file."""
        self._cell = cell
        self._T_flange_sensor = cell.sensor.T_flange_sensor.pose
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self.in_use: ActiveCalibration = initial_calibration(cell)
        self._calibrate(self.in_use, now_ns)  # after a restart the age of the zero is unknown
        # The last readings (force, torque; sensor axes) with the flange's pose; cleared by a gap.
        self._window = round(WINDOW_S * cell.rates.sensor_hz)
        self.recent: deque[tuple[tuple[float, ...], pin.SE3]] = deque(maxlen=self._window)

    def tare(self, context: RequestContext, _: Empty) -> Reply:
        """Take the present reading as zero."""
        if (trip := self._not_at_rest(context) or _in_contact(context.contact)) is not None:
            return refused(trip)
        readings = [np.array(reading) for reading, _ in self.recent]
        R = (context.T_base_flange * self._T_flange_sensor).rotation
        force = self._cell.force
        found = tare(
            self.in_use.payload,
            readings,
            R,
            most_N=force.tare_max_N,
            most_Nm=force.tare_max_Nm,
            calibrated=self._calibrated,
        )
        if isinstance(found, Trip):
            return refused(found)
        self._activate(replace(self.in_use, payload=found.payload, tared=True), context.now_ns)
        return Reply(accepted=True, text=str(found), value=found.change_N)

    def calibrate(self, context: RequestContext, request: CalibrationRequest) -> Reply:
        """Activate another calibration if it explains the present reading."""
        try:
            found = parse_calibration(request.calibration_json)
        except DataError as error:
            return refused(tripped("malformed", f"not a calibration: {error}"))
        new = active_calibration(found, self._cell)
        if new.objection:
            return refused(tripped("payload", new.objection))
        if (trip := self._not_at_rest(context)) is not None:
            return refused(trip)
        fx, fy, fz, mx, my, mz = np.mean([reading for reading, _ in self.recent], axis=0).tolist()
        mean = Wrench((fx, fy, fz), (mx, my, mz))
        left = self._compensation_of(new.payload).at_tcp(mean, context.T_base_flange)
        force_N, torque_Nm = hypot(*left.force_N), hypot(*left.torque_Nm)
        most_N, most_Nm = self._cell.force.idle_max_N, self._cell.force.idle_max_Nm
        if force_N > most_N or torque_Nm > most_Nm:
            text = (
                f"calibration {found.revision} leaves {force_N:.1f} N and {torque_Nm:.2f} N m "
                "about the TCP of the present reading: the tool is in contact, or another tool is "
                "mounted"
            )
            value, limit = (force_N, most_N) if force_N > most_N else (torque_Nm, most_Nm)
            return refused(tripped("contact", text, value=value, limit=limit))
        self._calibrate(new, context.now_ns)
        text = f"calibration {found.revision} is in use: residual {force_N:.2f} N and "
        return Reply(accepted=True, text=f"{text}{torque_Nm:.3f} N m of the present reading")

    def axes_checked(self, _: RequestContext, request: AxesRequest) -> Reply:
        """Record that axes and signs were checked with the calibration in use."""
        if request.calibration != self.in_use.origin:
            text = (
                f"axes were checked with calibration {request.calibration!r}, but "
                f"{self.in_use.origin!r} is in use: check them again"
            )
            return refused(tripped("payload", text))
        torques = self.in_use.torques_checked or request.torques
        self.in_use = replace(self.in_use, axes_checked=True, torques_checked=torques)
        text = f"axes and signs are checked with calibration {self.in_use.origin!r}"
        return Reply(accepted=True, text=text)

    def _calibrate(self, calibration: ActiveCalibration, now_ns: int) -> None:
        self._calibrated = calibration.payload  # before any tare
        self._activate(calibration, now_ns)

    def _activate(self, calibration: ActiveCalibration, now_ns: int) -> None:
        """Use a calibration whose bias dates from `now_ns`."""
        self.in_use, self.zero_since_ns = calibration, now_ns
        self.compensation = self._compensation_of(calibration.payload)

    def _compensation_of(self, payload: Payload) -> Compensation:
        return Compensation(payload, self._T_flange_sensor, self._T_flange_tcp)

    def _not_at_rest(self, context: RequestContext) -> Trip | None:
        """Refuse with invalid inputs, with force feedback, and unless the flange is at rest."""
        if context.fault is not None:
            return context.fault
        if context.feedback_runs:
            return tripped("busy", "force feedback is running: stop it first")
        if len(self.recent) < self._window:
            return tripped("wait", "not enough samples yet: repeat the request")
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
        return tripped("moving", text, value=value, limit=limit)


def _in_contact(contact: ContactEvent | None) -> Trip | None:
    """Refuse while the regulator reports contact: its force would be taken for bias."""
    if contact is None or contact.state not in TOUCHING:
        return None
    text = (
        f"the tool has been in contact for {contact.duration_s:.1f} s, with up to "
        f"{contact.peak_N:.1f} N: {FREE_FIRST}"
    )
    return tripped("contact", text, value=contact.peak_N)


class Tared(NamedTuple):
    """Payload with a new bias, and the change of the bias."""

    payload: Payload
    change_N: float
    change_Nm: float

    def __str__(self) -> str:
        """Return a description."""
        return (
            f"tared: force and torque are zero now; the bias changed by {self.change_N:.2f} N "
            f"and {self.change_Nm:.3f} N m"
        )


def tare(
    payload: Payload,
    samples: Sequence[Array],
    R_base_sensor: Array,
    *,
    most_N: float,
    most_Nm: float,
    calibrated: Payload | None = None,
) -> Tared | Trip:
    """Return the payload with the new bias, or why it is refused.

    Only the bias changes, by the mean residual of the readings after bias and weight. The change
    is limited, and so is the sum of all changes since the calibration: a contact that is tared
    step by step is not drift. It must not absorb the weight of the tool either: that would hide a
    wrong sign, axis or unit.

    Args:
        payload: The present payload.
        samples: Readings at rest, force then torque, sensor axes. Each of shape (6,).
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3).
        most_N: Largest change of bias, `force.tare_max_N`; a larger one is taken for contact.
        most_Nm: The same for the torque, `force.tare_max_Nm`.
        calibrated: The payload before the first tare; None: the present one is not tared.
    """
    mean = np.mean(samples, axis=0)
    shift, total = [
        residual(each, R_base_sensor, force_N=mean[:3], torque_Nm=mean[3:])
        for each in (payload, calibrated or payload)
    ]
    (change_N, change_Nm), (total_N, total_Nm) = [
        [float(np.linalg.norm(part)) for part in each] for each in (shift, total)
    ]
    for change, since, most, key, unit in (
        (change_N, total_N, most_N, "force.tare_max_N", "N"),
        (change_Nm, total_Nm, most_Nm, "force.tare_max_Nm", "N m"),
    ):
        if max(change, since) > most:
            text = (
                f"the bias would change by {change:.1f} {unit}: {since:.1f} {unit} since the "
                f"calibration, {key} allows {most:g} {unit}; {FREE_FIRST}"
            )
            return tripped("contact", text, value=max(change, since), limit=most, unit=unit)
    weight_N, changed_N = payload.mass_kg * GRAVITY_M_S2, max(change_N, total_N)
    if weight_N >= LEAST_WEIGHT_N and changed_N > WEIGHT_SHARE * weight_N:
        text = (
            f"the bias would change by {changed_N:.1f} N and the tool weighs {weight_N:.1f} N: "
            "a sign, an axis or a unit of the sensor, or the payload, is wrong"
        )
        return tripped("payload", text, value=changed_N, limit=WEIGHT_SHARE * weight_N, unit="N")
    shift_N, shift_Nm = shift
    bias = {
        "bias_force_N": vec3(np.array(payload.bias_force_N) + shift_N * payload.force_gain),
        "bias_torque_Nm": vec3(np.array(payload.bias_torque_Nm) + shift_Nm),
    }
    return Tared(payload.model_copy(update=bias), change_N, change_Nm)
