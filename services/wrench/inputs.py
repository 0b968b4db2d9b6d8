"""Input checks: state of the sensor topic, and time offset of wrench and pose. Pure."""

from dataclasses import dataclass
from typing import Any

from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S
from forcemesh.messages import SensorWrench
from services.wrench.plausibility import WrenchFault

LONGEST_TEXT = 400


def sensor_fault(sensor: Reading[SensorWrench]) -> WrenchFault:
    """Return the fault that the sensor topic reports, before its numbers are checked."""
    if sensor.silent:
        return WrenchFault("sensor_silent", sensor.fault)
    sample = sensor.message
    if sample is not None and sample.status != "ok" and sensor.code in ("", "invalid"):
        code = "sensor_saturated" if sample.status == "saturated" else "sensor_fault"
        reason = f": {sample.reason}" if sample.reason else ""
        return WrenchFault(code, f"the sensor reports {sample.status}{reason}"[:LONGEST_TEXT])
    if sensor.code == "invalid":
        return WrenchFault("sensor_fault", sensor.fault)
    return WrenchFault(sensor.code, sensor.fault)


@dataclass(frozen=True, slots=True)
class Pairing:
    """Sequence numbers of the newest sample and the newest pose, with their time offset."""

    sensor: int = 0
    robot: int = 0
    apart_s: float = 0.0  # how much older the one received last was


def pair(before: Pairing, sensor: Reading[Any], robot: Reading[Any]) -> Pairing:
    """Return the pairing with the time that a new message lies behind the other one.

    Only received messages are compared: a missing one is reported as silent, not as late.
    Clocks of two hosts are not compared.
    """
    if sensor.header is None or robot.header is None or sensor.header.boot != robot.header.boot:
        return before
    newer_s = (sensor.header.stamp_ns - robot.header.stamp_ns) / NS_PER_S
    behind_s = []
    if sensor.header.seq != before.sensor:
        behind_s.append(-newer_s)
    if robot.header.seq != before.robot:
        behind_s.append(newer_s)
    apart_s = max(behind_s, default=before.apart_s)
    return Pairing(sensor.header.seq, robot.header.seq, apart_s)
