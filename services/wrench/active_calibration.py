"""Active calibration and its validity for this cell, tool and sensor. Pure."""

from dataclasses import dataclass
from math import acos, degrees

from pydantic import ValidationError

from common.config.calibration import NO_FILE, CalibrationSection
from common.config.cell import CellConfig
from common.config.cell_terms import FrameSection
from common.config.payload import Payload
from common.motion.frames import apart, dot
from forcemesh.errors import DataError, first_mistake

SAME_M, SAME_DEG = 1e-4, 0.1  # tolerance for a pose that was typed again
MOST_LEAN_DEG = 15.0  # of the base, as identified: beyond, the arm is mounted otherwise
HEAVIER = 1.1  # times `contact.inertia_kg`: less than the adaptive law's own margin (bench.force)
OF_THE_CELL_FILE = "cell file"
CALIBRATE_FIRST = (
    "calibrate first: the cell file names no calibration file, or the named one is not there; run "
    "`forcemesh calibrate`, or set `calibration: none` if its section payload is right"
)


@dataclass(frozen=True, slots=True)
class ActiveCalibration:
    """Payload that is subtracted, with its origin and the objection to it."""

    payload: Payload
    origin: str  # revision of a calibration, or OF_THE_CELL_FILE
    sensor: str = ""  # serial number of the sensor it was made with, empty if unknown
    objection: str = ""  # why it is not valid in this cell
    axes_checked: bool = False  # axes and signs of the force are known to be right with it
    torques_checked: bool = False  # those of the torque as well
    tared: bool = False

    def fault(self, sensor: str) -> str:
        """Return why force feedback must not use it with the sensor of this serial number.

        An empty number is that of a sensor that reports none: it could be any.
        """
        if self.objection or not self.sensor or sensor == self.sensor:
            return self.objection
        this = f"is {sensor}" if sensor else "reports no serial number"
        return (
            f"calibration {self.origin} was made with sensor {self.sensor}, but this sensor "
            f"{this}: run `forcemesh calibrate`"
        )


def initial_calibration(cell: CellConfig) -> ActiveCalibration:
    """Return the initial calibration of a cell: stored, or the payload of the cell file.

    The payload is valid only in a cell that states `calibration: none`.
    """
    if isinstance(cell.calibration, CalibrationSection):
        return active_calibration(cell.calibration, cell)
    section = cell.payload
    objection = "" if cell.calibration == NO_FILE else CALIBRATE_FIRST
    if not objection and not section.weighs and not section.accept_uncalibrated:
        objection = (
            "payload.mass_kg and payload.com_m are zero: the tool's weight would read as contact; "
            "run `forcemesh calibrate`"
        )
    objection = objection or _too_heavy(section.mass_kg, cell)
    is_given = cell.sensor.axes_given
    return ActiveCalibration(
        section,
        OF_THE_CELL_FILE,
        objection=objection,
        axes_checked=is_given,
        torques_checked=is_given,
    )


def active_calibration(found: CalibrationSection, cell: CellConfig) -> ActiveCalibration:
    """Return a stored calibration with its validity in this cell."""
    axes, is_given = found.axes_of(cell.robot.model), cell.sensor.axes_given
    return ActiveCalibration(
        found.payload,
        found.revision,
        found.sensor,
        _objection(found, cell),
        axes_checked=is_given or axes is not None,
        torques_checked=is_given or (axes is not None and axes.torques),
    )


def parse_calibration(text: str) -> CalibrationSection:
    """Parse a calibration received over the bus. Raises DataError with the mistake."""
    try:
        return CalibrationSection.model_validate_json(text)
    except ValidationError as error:
        first = first_mistake(error)
        raise DataError(f"{first.where or 'calibration'}: {first.what}") from error


def _objection(found: CalibrationSection, cell: CellConfig) -> str:
    """Return why a calibration is not valid for this cell."""
    name = f"calibration {found.revision}"
    if found.cell != cell.cell:
        return f"{name} is of cell {found.cell}, but this is {cell.cell}: run `forcemesh calibrate`"
    if found.tool != cell.tool.name:
        return (
            f"{name} is of tool {found.tool or 'without a name'!r}, but the cell file names "
            f"{cell.tool.name or 'no name'!r}: run `forcemesh calibrate` with this tool"
        )
    for what, then, now in (
        ("tool.T_flange_tcp", found.T_flange_tcp, cell.tool.T_flange_tcp),
        ("sensor.T_flange_sensor", found.T_flange_sensor, cell.sensor.T_flange_sensor),
    ):
        apart = _apart(then, now)
        if apart:
            return f"{what} differs by {apart} from that of {name}: run `forcemesh calibrate`"
    share = dot(found.payload.gravity_direction_in_base, cell.gravity_direction_in_base)
    lean_deg = degrees(acos(max(-1.0, min(1.0, share))))
    if lean_deg > MOST_LEAN_DEG:
        return (
            f"{name} identified gravity {lean_deg:.0f} degrees from gravity_direction_in_base, the "
            f"limit is {MOST_LEAN_DEG:g}: correct that key, or run `forcemesh calibrate`"
        )
    return _unverified(found, cell) or _too_heavy(found.payload.mass_kg, cell)


def _unverified(found: CalibrationSection, cell: CellConfig) -> str:
    """Return why a fit is not verified: no fresh poses, or a residual beyond the limits."""
    name, verification = f"calibration {found.revision}", found.verified
    if verification is None:
        return f"{name} was not verified on fresh poses: run `forcemesh calibrate`"
    force_N, torque_Nm = cell.force.idle_max_N, cell.force.idle_max_Nm
    if verification.force_max_N <= force_N and verification.torque_max_Nm <= torque_Nm:
        return ""
    return (
        f"{name} left {verification.force_max_N:.2f} N and "
        f"{verification.torque_max_Nm:.3f} N m at a fresh pose, "
        f"the limits are {force_N:g} N and {torque_Nm:g} N m: run `forcemesh calibrate`"
    )


def _too_heavy(mass_kg: float, cell: CellConfig) -> str:
    """Return an objection if the tool is heavier than the gain limits allow for."""
    inertia_kg = cell.contact.inertia_kg
    if mass_kg <= HEAVIER * inertia_kg:
        return ""
    return (
        f"the tool weighs {mass_kg:.2f} kg, but contact.inertia_kg is {inertia_kg:g}: on a soft "
        f"contact the force would oscillate; set it to at least {mass_kg:.2f}"
    )


def _apart(then: FrameSection, now: FrameSection) -> str:
    away_m, turn_rad = apart(then.pose, now.pose)
    turned_deg = degrees(turn_rad)
    if away_m <= SAME_M and turned_deg <= SAME_DEG:
        return ""
    return f"{away_m * 1e3:.1f} mm and {turned_deg:.1f} degrees"
