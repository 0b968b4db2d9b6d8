"""SYSDATA and $SYSDATA: values of the controller by keyword (reference manual, chapter 9).

Keywords that would need the arm's motors (MTR.RPM, POWER) or the speed of the command
(TOOL.VEL.CMD, JT.VEL.CMD) are not emulated: P0116, as for a keyword that does not exist.
"""

from collections.abc import Callable, Mapping

from sim.as_language.errors import AsError
from sim.controller.hardware import INPUTS, INTERNAL, OUTPUTS, Hardware
from sim.controller.motion_requests import LINEAR_MAX_M_S, MotionParameters
from sim.controller.tasks import ROBOT, TaskControl

NONE = -1.0  # no motion yet, or its speed is in seconds
ENGLISH = 2.0


def system_number(control: TaskControl, keyword: str, first: int = ROBOT, second: int = 1) -> float:
    """Return SYSDATA(keyword, first, second).

    Args:
        control: The programs of the controller.
        keyword: In lower case.
        first: Number of a robot, or of a task.
        second: Number of a joint, from 1.

    Raises:
        AsError: P0116 for a keyword that is not emulated, P0104 for another robot, E0106 for
            another joint or task.
    """
    if keyword == "step":
        return _step(control, first)
    read = _OF_ROBOT.get(keyword)
    if read is None:
        raise AsError("P0116", f"SYSDATA({keyword.upper()}) is not emulated")
    if first != ROBOT:
        raise AsError("P0104", f"SYSDATA({keyword.upper()}): robot {first}, there is robot 1")
    if keyword.startswith("mtr.") and second not in range(1, 7):
        raise AsError("E0106", f"SYSDATA: joint {second}; joints are 1 to 6")
    return read(control, second)


def system_text(control: TaskControl, keyword: str) -> str:
    """Return $SYSDATA(keyword). Raises AsError P0116 for a keyword that is not emulated."""
    if keyword != "zrob.name":
        raise AsError("P0116", f"$SYSDATA({keyword.upper()}) is not emulated")
    return control.hardware.robot.arm.settings.arm.upper()


def _step(control: TaskControl, number: int) -> float:
    for task in control.tasks:
        if task.number == number:
            return float(task.step_index + 1) if task.frames else NONE
    raise AsError("E0106", f"SYSDATA(STEP,{number}): 1 is the robot program, 1001 to 1005 are PC")


def _last_motion(hardware: Hardware) -> MotionParameters | None:
    motion = hardware.robot.queue.last
    return None if motion is None or motion.manner.speed.unit == "S" else motion.manner


def _speed(scale: float) -> Callable[[TaskControl, int], float]:
    """Return a reader of the program speed of the last motion; `scale` is full speed."""

    def read(control: TaskControl, _: int) -> float:
        manner = _last_motion(control.hardware)
        if manner is None:
            return NONE
        return scale * manner.speed.linear_share

    return read


def _ramp(name: str) -> Callable[[TaskControl, int], float]:
    def read(control: TaskControl, _: int) -> float:
        manner = _last_motion(control.hardware)
        return NONE if manner is None else 100.0 * float(getattr(manner, name))

    return read


def _monitor_speed(control: TaskControl, _: int) -> float:
    queue = control.hardware.robot.queue
    return 100.0 * queue.monitor_fraction if queue.is_moving else NONE


def _motor_current_A(control: TaskControl, joint: int) -> float:
    return float(control.hardware.robot.arm.data.actuator_force[joint - 1])  # as IQARM


def _constant(value: float) -> Callable[[TaskControl, int], float]:
    return lambda _, __: value


_OF_ROBOT: Mapping[str, Callable[[TaskControl, int], float]] = {
    "m.speed": _monitor_speed,
    "mstep": lambda control, _: float(control.hardware.motion_step),
    "p.speed": _speed(100.0),
    "p.speed.m": _speed(1e3 * LINEAR_MAX_M_S),
    "p.accel": _ramp("accel_fraction"),
    "p.decel": _ramp("decel_fraction"),
    "mtr.curr": _motor_current_A,
    "mtr.curr.cmd": _motor_current_A,
    "numrobot": _constant(1.0),
    "zrob.mgfno": _constant(1.0),
    "cont.no": _constant(1.0),
    "zrob.nowaxis": lambda control, _: float(control.hardware.robot.kinematics.joints),
    "sig.do": _constant(float(len(OUTPUTS))),
    "sig.di": _constant(float(len(INPUTS))),
    "sig.int": _constant(float(len(INTERNAL))),
    "language": _constant(ENGLISH),
    "mem.free": _constant(100.0),
    "error.code": lambda control, _: float(control.error_number),
    "error.axis": _constant(0.0),
}
