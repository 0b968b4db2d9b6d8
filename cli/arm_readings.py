"""Present force, pose, calibration and tare of a cell, as data and as lines for people."""

from collections.abc import Sequence
from typing import Any, TypedDict

from common.config.cell import CellConfig
from common.config.info import cell_info
from forcemesh import topics
from forcemesh.bus import Bus, Reading
from forcemesh.client.force import press_force_N
from forcemesh.client.rotations import to_oat_deg
from forcemesh.messages import (
    Health,
    Joints,
    Quaternion,
    RegulatorTarget,
    RobotState,
    Vec3,
    WrenchAtTcp,
)


class ForceReading(TypedDict):
    """Force and torque on the tool about the TCP, base axes; None without valid data."""

    press_N: float | None  # along the tool's z axis; positive when the tool presses
    force_N: Vec3 | None
    torque_Nm: Vec3 | None
    setpoint_N: float | None  # None while force feedback is off
    contact: str  # free, approach or contact; empty while force feedback is off
    fault: str


class PoseReading(TypedDict):
    """Flange pose in base and joint angles; None without valid data."""

    position_m: Vec3 | None
    orientation_xyzw: Quaternion | None
    joint_rad: Joints | None
    fault: str


class CalibrationReading(TypedDict):
    """Calibration that the wrench service subtracts, and the age of its bias."""

    name: str  # revision
    tared: bool
    calibrated: bool  # whether force feedback may rely on it
    axes_checked: bool
    bias_age_h: float | None  # since the last tare, or since the start
    fault: str


class ArmReadings(TypedDict):
    """What the arm feels, where it is, and what its force is computed with."""

    force: ForceReading
    pose: PoseReading
    calibration: CalibrationReading


class ArmView:
    """Subscriber to force, pose and set point of one cell."""

    def __init__(self, bus: Bus, cell: CellConfig) -> None:
        """Subscribe."""
        self._clock = bus.clock
        self._T_flange_tcp = cell_info(cell).T_flange_tcp
        self._wrench = bus.reader(topics.WRENCH)
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._target = bus.reader(topics.REGULATOR_TARGET)

    def is_complete(self) -> bool:
        """Return whether force, pose and set point were received, valid or not."""
        return all(
            reader.read(self._clock.now_ns()).message is not None
            for reader in (self._wrench, self._robot, self._target)
        )

    def readings(self, health: Health | None) -> ArmReadings:
        """Return the present readings. `health` is that of the wrench service."""
        now_ns = self._clock.now_ns()
        robot, wrench = self._robot.read(now_ns), self._wrench.read(now_ns)
        measured, press_N = wrench.fresh, None
        if measured is not None and robot.fresh is not None:
            press_N = press_force_N(robot.fresh, measured, self._T_flange_tcp)
        target = self._target.read(now_ns).fresh
        return _readings(wrench, robot, target, press_N=press_N, health=health)


def no_readings() -> ArmReadings:
    """Return the readings of a cell whose hub does not respond."""
    nothing: Reading[Any] = Reading(None, None, 0.0, "no hub responds", silent=True)
    return _readings(nothing, nothing, None, press_N=None, health=None)


def _readings(
    wrench: Reading[WrenchAtTcp],
    robot: Reading[RobotState],
    target: RegulatorTarget | None,
    *,
    press_N: float | None,
    health: Health | None,
) -> ArmReadings:
    measured, state = wrench.fresh, robot.fresh
    used = measured or WrenchAtTcp()  # by default without a calibration
    return ArmReadings(
        force=ForceReading(
            press_N=press_N,
            force_N=None if measured is None else measured.force_N,
            torque_Nm=None if measured is None else measured.torque_Nm,
            setpoint_N=None if target is None else target.setpoint_N,
            contact="" if target is None else target.contact,
            fault=wrench.fault,
        ),
        pose=PoseReading(
            position_m=None if state is None else state.position_m,
            orientation_xyzw=None if state is None else state.orientation_xyzw,
            joint_rad=None if state is None else state.joint_rad,
            fault=robot.fault,
        ),
        calibration=CalibrationReading(
            name=used.calibration,
            tared=used.tared,
            calibrated=used.calibrated,
            axes_checked=used.axes_checked,
            bias_age_h=None if health is None else health.numbers.get("tare_age_h"),
            fault=wrench.fault if measured is None else measured.calibration_fault,
        ),
    )


# --- lines for people -----------------------------------------------------------------------------


def reading_lines(readings: ArmReadings) -> list[tuple[str, str]]:
    """Return label and text of each reading; missing data is named, never shown as zero."""
    return [
        ("force", _force_text(readings["force"])),
        ("pose", _pose_text(readings["pose"])),
        ("calibration", _calibration_text(readings["calibration"])),
    ]


def _force_text(force: ForceReading) -> str:
    if force["force_N"] is None or force["torque_Nm"] is None:
        return f"no data: {force['fault']}"
    texts = [] if force["press_N"] is None else [f"press force {force['press_N']:.2f} N"]
    if force["setpoint_N"] is not None:
        phase = {"free": "", "approach": " (approaching)", "contact": " (in contact)"}
        texts.append(f"set point {force['setpoint_N']:g} N{phase[force['contact']]}")
    texts.append(f"({_numbers(force['force_N'], 2)}) N, ({_numbers(force['torque_Nm'], 3)}) N m")
    return ", ".join(texts) + " in base axes"


def _pose_text(pose: PoseReading) -> str:
    if pose["position_m"] is None or pose["orientation_xyzw"] is None:
        return f"no data: {pose['fault']}"
    oat_deg = to_oat_deg(pose["orientation_xyzw"])
    position = _numbers([1e3 * value for value in pose["position_m"]], 1)
    return f"flange at {position} mm, O A T {_numbers(oat_deg, 1)} degrees"


def _calibration_text(calibration: CalibrationReading) -> str:
    if not calibration["name"]:
        return f"no data: {calibration['fault']}"
    texts = [calibration["name"], *(["tared"] if calibration["tared"] else [])]
    if (hours := calibration["bias_age_h"]) is not None:
        minutes = 60.0 * hours
        age = f"{minutes:.0f} min" if minutes < 120.0 else f"{hours:.1f} h"
        texts.append(f"bias {age} old")
    texts.append("axes checked" if calibration["axes_checked"] else "axes not checked")
    if not calibration["calibrated"]:
        texts.append(f"not for force feedback: {calibration['fault']}")
    return ", ".join(texts)


def _numbers(values: Sequence[float], digits: int) -> str:
    # Adding zero turns -0.0 into 0.0.
    return ", ".join(f"{round(value, digits) + 0.0:.{digits}f}" for value in values)
