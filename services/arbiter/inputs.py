"""What the arbiter knows at one moment, and what is wrong with it. Pure."""

from dataclasses import dataclass

import numpy as np

from common.clock import NS_PER_S
from common.convert import pose_of
from common.endpoints import Reading
from common.limits import Limits, check_workspace, check_wrench
from common.messages import (
    Health,
    RegulatorTarget,
    RobotState,
    SensorWrench,
    Trip,
    Vec3,
    WrenchAtTcp,
)

Writers = dict[str, int]  # topic: epoch of the process that writes it

ROBOT_ANSWERS_WITHIN_S = 0.3  # a robot that still holds after this does not accept the lease
# The controller's bits that must be as named before anything moves, and what to do about each.
PRECONDITIONS = {
    "motor_power": (True, "switch the motors on"),
    "repeat_mode": (True, "switch to REPEAT"),
    "teach_lock_off": (True, "switch TEACH LOCK off"),
    "program_running": (True, "start the controller's program"),
    "watchdog_latched": (False, "reconnect: the controller's watchdog has latched"),
    "error": (False, "reset the controller's error"),
}


@dataclass(frozen=True, slots=True)
class Inputs:
    """One snapshot of everything that the arbiter reads."""

    now_ns: int
    robot: Reading[RobotState]
    sensor: Reading[SensorWrench]
    wrench: Reading[WrenchAtTcp]
    target: Reading[RegulatorTarget]
    health: dict[str, Reading[Health]]


def missing(inputs: Inputs) -> list[str]:
    """Return one line for each input that is missing, invalid or stale.

    The regulator's target need not be valid (it is not while nobody asks for force feedback),
    but the regulator must be heard.
    """
    faults = [reading.fault for reading in (inputs.robot, inputs.sensor, inputs.wrench)]
    if inputs.target.silent:
        faults.append(inputs.target.fault)
    faults += [reading.fault for reading in inputs.health.values()]
    return [fault for fault in faults if fault]


def robot_complaints(inputs: Inputs) -> list[str]:
    """Return what the robot's status bits lack for motion."""
    robot = inputs.robot.fresh
    if robot is None:
        return []
    return [
        remedy
        for name, (wanted, remedy) in PRECONDITIONS.items()
        if getattr(robot.status, name) is not wanted
    ]


def strangers(inputs: Inputs, config_hash: str) -> list[str]:
    """Return the roles that run with another cell file than this one."""
    return [
        f"{role} runs with another cell file ({health.fresh.config_hash}, here {config_hash})"
        for role, health in inputs.health.items()
        if health.fresh is not None and health.fresh.config_hash != config_hash
    ]


def fault_trip(inputs: Inputs) -> Trip | None:
    """Return why motion must end in FAULT: an input is gone or the robot is not fit to move."""
    lines = missing(inputs)
    if lines:
        return Trip(code="input", text="; ".join(lines)[:400])
    complaints = robot_complaints(inputs)
    if complaints:
        return Trip(code="robot", text="; ".join(complaints)[:400])
    return None


def writers(inputs: Inputs) -> Writers:
    """Return which process writes what is judged in motion."""
    readings = (inputs.robot, inputs.sensor, inputs.wrench, inputs.target)
    names = ("robot/state", "sensor/wrench", "wrench", "regulator/target")
    headers = zip(names, (reading.header for reading in readings), strict=True)
    return {name: header.epoch for name, header in headers if header is not None}


def replaced_trip(inputs: Inputs, at_arming: Writers) -> Trip | None:
    """Return the input that another process writes than when the arm was armed."""
    now = writers(inputs)
    replaced = [name for name, epoch in at_arming.items() if now.get(name) != epoch]
    if not replaced:
        return None
    text = f"another process writes {', '.join(replaced)} than when the arm was armed"
    return Trip(code="writer", text=text)


def robot_trip(inputs: Inputs, lease_since_ns: int) -> Trip | None:
    """Return why the robot holds although it may move: it has seen something that we have not."""
    robot = inputs.robot.fresh
    since_s = (inputs.now_ns - lease_since_ns) / NS_PER_S
    if robot is None or not robot.hold_reason or since_s < ROBOT_ANSWERS_WITHIN_S:
        return None
    return Trip(code="robot_holds", text=f"the robot holds: {robot.hold_reason}"[:400])


def limit_trip(inputs: Inputs, limits: Limits, p_flange_tcp_m: Vec3) -> Trip | None:
    """Return why motion must end in HOLDING: too much force, or outside the workspace."""
    wrench, robot = inputs.wrench.fresh, inputs.robot.fresh
    if wrench is None or robot is None:
        return None
    trip = check_wrench(limits, np.array(wrench.force_N), np.array(wrench.torque_Nm))
    if trip is not None:
        return trip
    T_base_tcp = pose_of(robot)
    T_base_tcp.translation = T_base_tcp.act(np.array(p_flange_tcp_m))
    return check_workspace(limits, T_base_tcp)
