"""Snapshot of the arbiter's inputs, and the faults visible in one snapshot. Pure."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from common.motion.convert import pose_of
from common.motion.limits import Limits, check_workspace, check_wrench
from common.runtime.overruns import MOST_OVERRUNS
from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import (
    Health,
    RegulatorTarget,
    RobotState,
    SensorWrench,
    Trip,
    Vec3,
    WrenchAtTcp,
)

Writers = dict[str, int]  # topic: epoch of its publisher

COMMANDING = ("robot", "sensor", "wrench", "regulator")  # roles whose loops motion depends on

OWN_HOLDS = ("hold", "no_lease")  # repeated from the arbiter: the new lease is not received yet
ROBOT_ANSWERS_WITHIN_S = 0.3  # a robot that still holds after this does not accept the lease


@dataclass(frozen=True, slots=True)
class Watched:
    """Faults found over several snapshots (watch.py)."""

    faults: tuple[Trip, ...] = ()  # they end motion
    motion_at_rest_violation: Trip | None = None  # why the arm does not count as at rest
    residual: Trip | None = None  # residual force in free space
    calibration: Trip | None = None  # why running force feedback must not use the wrench
    slow: Trip | None = None  # why the controller is too slow to start force feedback
    slower: Trip | None = None  # why the controller is too slow for running force feedback


@dataclass(frozen=True, slots=True)
class Inputs:
    """Snapshot of all inputs of the arbiter."""

    now_ns: int
    robot: Reading[RobotState]
    sensor: Reading[SensorWrench]
    wrench: Reading[WrenchAtTcp]
    target: Reading[RegulatorTarget]
    health: dict[str, Reading[Health]]
    watched: Watched = Watched()

    @property
    def streams(self) -> dict[str, Reading[Any]]:
        """Inputs that are checked every period in motion, by topic."""
        return {
            "robot/state": self.robot,
            "sensor/wrench": self.sensor,
            "wrench": self.wrench,
            "regulator/target": self.target,
        }


FORCE_ROLES = ("sensor", "wrench")  # roles that backing off does not require


def missing(inputs: Inputs, *, blind: bool = False) -> list[Trip]:
    """Return one trip for each input that is missing, invalid, stale or untrustworthy.

    The regulator's target need not be valid (it is invalid while no force feedback runs), but it
    must be received.

    Args:
        inputs: The snapshot.
        blind: To back off without a measured force: sensor and wrench may be missing.
    """
    return [
        *_rivals(inputs),
        *_lost_inputs(inputs, blind=blind),
        *_overruns(inputs),
        *inputs.watched.faults,
    ]


def _rivals(inputs: Inputs) -> list[Trip]:
    streams = [topic for topic, reading in inputs.streams.items() if reading.conflict]
    health = [f"{role}/health" for role, reading in inputs.health.items() if reading.conflict]
    return [tripped("two_writers", f"two processes write {topic}") for topic in streams + health]


def _overruns(inputs: Inputs) -> list[Trip]:
    """Check the other loops by their health; the arbiter's own one is measured directly."""
    return [
        overrun_trip(role, health.overruns, health.longest_gap_s)
        for role, reading in inputs.health.items()
        if role in COMMANDING
        and (health := reading.fresh) is not None
        and health.overruns > MOST_OVERRUNS
    ]


def overrun_trip(role: str, overruns: int, longest_gap_s: float) -> Trip:
    """Return the trip of a loop with repeated overruns."""
    text = f"{role} was late {overruns} times within a second, by {longest_gap_s * 1e3:.0f} ms"
    return tripped("overrun", text, value=overruns, limit=MOST_OVERRUNS)


def _lost_inputs(inputs: Inputs, *, blind: bool) -> list[Trip]:
    force_readings = [] if blind else _force_readings(inputs)
    readings: list[Reading[Any]] = [inputs.robot, *force_readings]
    if inputs.target.silent:
        readings.append(inputs.target)
    health = [
        health_reading
        for role, health_reading in inputs.health.items()
        if not (blind and role in FORCE_ROLES)
    ]
    lost = [reading for reading in (*readings, *health) if reading.fault]
    return [_lost(reading, is_sensor=reading is inputs.sensor) for reading in lost]


def _force_readings(inputs: Inputs) -> list[Reading[Any]]:
    """Return sensor and wrench, without a wrench that only repeats the sensor's fault."""
    sensor, wrench = inputs.sensor, inputs.wrench
    if sensor.fault and wrench.fault and not wrench.silent:
        same = _lost(sensor, is_sensor=True).code
        if wrench.code == same or wrench.code.startswith("sensor_"):
            return [sensor]
    return [sensor, wrench]


def robot_faults(inputs: Inputs) -> list[Trip]:
    """Return what keeps the robot from following commands, by its own status."""
    robot = inputs.robot.fresh
    if robot is None or (robot.status.ready and not robot.status.faults):
        return []
    faults = [_fault_of_robot(fault) for fault in robot.status.faults]
    return faults or [tripped("robot_error", "the robot is not ready and names no cause")]


def _fault_of_robot(fault: Trip) -> Trip:
    """Return a fault of the robot with its remedy; its code may be of another version."""
    if fault.code not in FAULTS:
        return fault.replaced(code="robot_error", rule=FAULTS["robot_error"].rule)
    return fault.replaced(text=FAULTS[fault.code].remedy)


def mismatched_roles(inputs: Inputs, config_hash: str, version: str) -> list[Trip]:
    """Return the roles with another cell file or version than the arbiter's."""
    trips = []
    for role, reading in inputs.health.items():
        health = reading.fresh
        if health is not None and health.config_hash != config_hash:
            text = f"{role} runs with another cell file ({health.config_hash}, here {config_hash})"
            trips.append(tripped("config", text))
        if health is not None and health.version != version:
            text = f"{role} runs version {health.version}, here {version}"
            trips.append(tripped("version", text))
    return trips


def fault_trips(inputs: Inputs) -> list[Trip]:
    """Return why motion must end in FAULT: an input is missing or the robot cannot move."""
    return missing(inputs) or robot_faults(inputs)


def _lost(reading: Reading[Any], *, is_sensor: bool) -> Trip:
    code = reading.code if reading.code in FAULTS else "invalid"
    return tripped("sensor_silent" if is_sensor and reading.silent else code, reading.fault)


def writers(inputs: Inputs) -> Writers:
    """Return the publishers of the inputs that are checked in motion."""
    headers = {name: reading.header for name, reading in inputs.streams.items()}
    return {name: header.epoch for name, header in headers.items() if header is not None}


def predecessor_trips(inputs: Inputs) -> tuple[Trip, ...]:
    """Return why a restarted arbiter holds an arm that its predecessor has moved."""
    robot = inputs.robot.fresh
    if robot is None or robot.accepted is None:
        return ()
    text = "the arm has moved under a previous arbiter process: the arbiter was restarted"
    return (tripped("writer", text),)


def replaced_trips(inputs: Inputs, at_arming: Writers) -> list[Trip]:
    """Return the inputs whose publisher has changed since arming."""
    now = writers(inputs)
    replaced = [name for name, epoch in at_arming.items() if now.get(name) != epoch]
    if not replaced:
        return []
    text = f"the publisher of {', '.join(replaced)} has changed since arming"
    return [tripped("writer", text)]


def robot_trip(inputs: Inputs, lease_since_ns: int) -> Trip | None:
    """Return why the robot holds under a valid permission: its own checks found a cause."""
    robot = inputs.robot.fresh
    since_s = (inputs.now_ns - lease_since_ns) / NS_PER_S
    if robot is None or robot.hold is None or since_s < ROBOT_ANSWERS_WITHIN_S:
        return None
    hold = robot.hold
    return tripped(
        hold.code if hold.code in FAULTS and hold.code not in OWN_HOLDS else "robot_holds",
        f"the robot holds: {hold.text}",
        value=hold.value,
        limit=hold.limit,
        unit=hold.unit,
    )


def limit_trip(inputs: Inputs, limits: Limits, p_flange_tcp_m: Vec3) -> Trip | None:
    """Return why motion must end in HOLDING: force above its ceiling, or outside the workspace."""
    wrench, robot = inputs.wrench.fresh, inputs.robot.fresh
    if wrench is None or robot is None:
        return None
    trip = check_wrench(limits, wrench.force_N, wrench.torque_Nm)
    if trip is not None:
        return trip
    T_base_tcp = pose_of(robot)
    T_base_tcp.translation = T_base_tcp.act(np.array(p_flange_tcp_m))
    return check_workspace(limits, T_base_tcp)
