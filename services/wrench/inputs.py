"""What is wrong with the sensor before its numbers are looked at; do wrench and pose fit? Pure."""

from dataclasses import dataclass
from typing import Any

from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S
from forcemesh.messages import SensorWrench
from services.wrench.plausibility import Complaint

LONGEST_TEXT = 400


def heard(sensor: Reading[SensorWrench]) -> Complaint:
    """Return what is wrong with the sensor before its numbers are looked at."""
    if sensor.silent:
        return Complaint("sensor_silent", sensor.fault)
    sample = sensor.message
    if sample is not None and sample.status != "ok" and sensor.code in ("", "invalid"):
        code = "sensor_saturated" if sample.status == "saturated" else "sensor_fault"
        reason = f": {sample.reason}" if sample.reason else ""
        return Complaint(code, f"the sensor says {sample.status}{reason}"[:LONGEST_TEXT])
    if sensor.code == "invalid":
        return Complaint("sensor_fault", sensor.fault)
    return Complaint(sensor.code, sensor.fault)


@dataclass(frozen=True, slots=True)
class Pairing:
    """The newest sample and the newest pose, by the numbers that their writers gave them."""

    sensor: int = 0
    robot: int = 0
    apart_s: float = 0.0  # by how much the one that came last was the older one


def pair(before: Pairing, sensor: Reading[Any], robot: Reading[Any]) -> Pairing:
    """Return how far a message that has just come lay behind the other one.

    Only what comes is judged: one that does not come is not late but silent, and named so.
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
