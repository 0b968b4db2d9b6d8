"""Snapshot of the arbiter's inputs, and the faults visible in one snapshot. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, NamedTuple

from common.runtime.overruns import MOST_OVERRUNS
from forcemesh.bus import Reading
from forcemesh.faults import FAULTS, input_trip, tripped
from forcemesh.messages import (
    Health,
    RegulatorTarget,
    RobotState,
    SensorWrench,
    Trip,
    WrenchAtTcp,
)

Writers = dict[str, int]  # topic: epoch of its publisher

COMMANDING = ("robot", "sensor", "wrench", "regulator")  # roles whose loops motion depends on


class Monitored(NamedTuple):
    """Faults found over several snapshots (monitors.py)."""

    faults: Sequence[Trip] = ()  # they end motion
    rest_s: float = inf  # time for which the arm has been at rest
    residual: Trip | None = None  # residual force in free space
    feedback: Trip | None = None  # why running force feedback must end


NOTHING_FOUND = Monitored()


@dataclass(slots=True)
class Inputs:
    """Snapshot of all inputs of the arbiter; only the monitors add their findings to it."""

    now_ns: int
    robot: Reading[RobotState]
    sensor: Reading[SensorWrench]
    wrench: Reading[WrenchAtTcp]
    target: Reading[RegulatorTarget]
    health: dict[str, Reading[Health]]
    monitored: Monitored = NOTHING_FOUND

    @property
    def streams(self) -> dict[str, Reading[Any]]:
        """Inputs that are checked every period in motion, by topic."""
        return {
            "robot/state": self.robot,
            "sensor/wrench": self.sensor,
            "wrench": self.wrench,
            "regulator/target": self.target,
        }

    def numbers(self, role: str) -> dict[str, float]:
        """Return the measurements in a role's health, empty while it is not received."""
        reading = self.health.get(role)
        health = None if reading is None else reading.fresh
        return {} if health is None else health.numbers


# Topics that backing off does not require.
FORCE_TOPICS = ("sensor/wrench", "wrench", "sensor/health", "wrench/health")


def missing(inputs: Inputs, *, blind: bool = False) -> list[Trip]:
    """Return one trip for each input that is missing, invalid, stale or untrustworthy.

    The regulator's target need not be valid (it is invalid while no force feedback runs), but it
    must be received.

    Args:
        inputs: The snapshot.
        blind: To back off without a measured force: sensor and wrench may be missing.
    """
    readings = inputs.streams
    rivals, lost, overruns = [], [], []
    for role, reading in inputs.health.items():
        if reading.fault or reading.conflict:
            readings[f"{role}/health"] = reading
        # The arbiter's own overruns are measured directly.
        if (
            role in COMMANDING
            and (health := reading.fresh) is not None
            and health.overruns > MOST_OVERRUNS
        ):
            count, gap_s, cause = health.overruns, health.longest_gap_s, health.late_cause
            overruns.append(overrun_trip(role, count, gap_s, cause))
    not_required = set(FORCE_TOPICS) if blind else set()
    if not blind and inputs.sensor.fault and _repeats_sensor_fault(inputs):
        not_required.add("wrench")
    if not inputs.target.silent:
        not_required.add("regulator/target")
    for topic, reading in readings.items():
        if reading.conflict:
            rivals.append(tripped("two_writers", f"two processes write {topic}"))
        if reading.fault and topic not in not_required:
            lost.append(_lost(reading, is_sensor=reading is inputs.sensor))
    return [*rivals, *lost, *overruns, *inputs.monitored.faults]


def overrun_trip(role: str, overruns: int, longest_gap_s: float, cause: str = "") -> Trip:
    """Return the trip of a loop with repeated overruns, with the cause if its process knows it."""
    text = f"{role} was late {overruns} times within a second, by {longest_gap_s * 1e3:.0f} ms"
    text = f"{text}: {cause}" if cause else text
    return tripped("overrun", text, value=overruns, limit=MOST_OVERRUNS)


def _repeats_sensor_fault(inputs: Inputs) -> bool:
    """Return whether an invalid wrench only repeats the fault of the sensor."""
    wrench = inputs.wrench
    if wrench.silent or not wrench.fault:
        return False
    same = _lost(inputs.sensor, is_sensor=True).code
    return wrench.code == same or wrench.code.startswith("sensor_")


def robot_faults(inputs: Inputs) -> list[Trip]:
    """Return what keeps the robot from following commands, by its own status."""
    robot = inputs.robot.fresh
    if robot is None or (robot.status.ready and not robot.status.faults):
        return []
    faults = [_robot_fault(fault) for fault in robot.status.faults]
    return faults or [tripped("robot_error", "the robot is not ready and names no cause")]


def _robot_fault(fault: Trip) -> Trip:
    """Return a fault of the robot with its own text, or with the remedy if that is the table's."""
    row = FAULTS.get(fault.code)
    if row is None:  # of another version
        return fault.replaced(code="robot_error", rule=FAULTS["robot_error"].rule)
    return fault if fault.text != row.cause else fault.replaced(text=row.remedy)


def late_error(trips: tuple[Trip, ...], inputs: Inputs) -> list[Trip]:
    """Return the robot's error that is read after the arm has stopped, unless it is a cause."""
    known = {trip.value for trip in trips if trip.code == "robot_error"}
    return [
        fault
        for fault in robot_faults(inputs)
        if fault.code == "robot_error" and fault.value is not None and fault.value not in known
    ]


def fault_trips(inputs: Inputs) -> list[Trip]:
    """Return why motion must end in FAULT: an input is missing or the robot cannot move."""
    return missing(inputs) or robot_faults(inputs)


def _lost(reading: Reading[Any], *, is_sensor: bool) -> Trip:
    code = "sensor_silent" if is_sensor and reading.silent else reading.code
    return input_trip(code, reading.fault)


def writers(inputs: Inputs) -> Writers:
    """Return the publishers of the inputs that are checked in motion."""
    return {
        topic: reading.header.epoch
        for topic, reading in inputs.streams.items()
        if reading.header is not None
    }


def predecessor_trips(inputs: Inputs) -> tuple[Trip, ...]:
    """Return why a restarted arbiter holds an arm that its predecessor has moved."""
    robot = inputs.robot.fresh
    if robot is None or robot.accepted is None:
        return ()
    text = "the arm has moved under a previous arbiter process: the arbiter was restarted"
    return (tripped("writer", text),)


def replaced_trips(inputs: Inputs, at_arming: Writers) -> list[Trip]:
    """Return the inputs whose publisher has changed since arming."""
    streams = inputs.streams
    replaced = [
        topic
        for topic, epoch in at_arming.items()
        if (header := streams[topic].header) is None or header.epoch != epoch
    ]
    if not replaced:
        return []
    text = f"the publisher of {', '.join(replaced)} has changed since arming"
    return [tripped("writer", text)]
