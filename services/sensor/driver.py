"""What every driver of a sensor is to the service: samples in SI, and words when there are none.

Pure: the interface, and what is judged alike for every make.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from forcemesh.messages import ZERO3, Vec3

SATURATED_FROM = 0.95  # of the range, on any one axis
AXES = (("Fx", "N"), ("Fy", "N"), ("Fz", "N"), ("Tx", "N m"), ("Ty", "N m"), ("Tz", "N m"))


class Complaint(NamedTuple):
    """What is wrong, as a code of forcemesh/faults.py and in words; both empty: nothing is."""

    code: str
    text: str


FINE = Complaint("", "")


@dataclass(frozen=True, slots=True)
class Sample:
    """A reading in SI, sensor axes, about the sensor's origin, and whether it can be trusted."""

    force_N: Vec3
    torque_Nm: Vec3
    status: Literal["ok", "saturated", "fault"] = "ok"
    reason: str = ""
    code: str = ""  # of forcemesh/faults.py
    counter: int = 0  # of samples since the driver started; those known to be lost are counted
    stamp_ns: int = 0  # when it was taken from the line, monotonic clock


@dataclass(frozen=True, slots=True)
class Info:
    """What is known of the sensor itself; an empty text is not known."""

    model: str
    force_range_N: float
    torque_range_Nm: float
    calibration: str  # whose numbers turn counts into N and N m
    serial: str = ""

    def __str__(self) -> str:
        serial = f" serial {self.serial}" if self.serial else ""
        ranges = f"{self.force_range_N:g} N, {self.torque_range_Nm:g} N m"
        return f"{self.model}{serial}, range {ranges}, {self.calibration}"


class Driver(Protocol):
    """One make of sensor. It never blocks and never raises once it was made."""

    @property
    def where(self) -> str:
        """Name of the sensor and its address for people."""

    def read(self, now_ns: int) -> Sequence[Sample]:
        """Return every sample that has come since the last call, oldest first."""

    def complaint(self) -> Complaint:
        """Return why no sample comes at present, as far as the driver can tell."""

    def info(self) -> Info | None:
        """Return what is known of the sensor, None while nothing is."""

    def counters(self) -> dict[str, int]:
        """Return what came, what was lost, what was dropped and why."""

    def close(self) -> None:
        """Stop the stream, let the line go."""


def fault_sample(code: str, reason: str, *, counter: int = 0, stamp_ns: int = 0) -> Sample:
    """Return a sample without a reading: a sensor in fault has none."""
    return Sample(ZERO3, ZERO3, "fault", reason, code, counter, stamp_ns)


def saturation(force_N: Vec3, torque_Nm: Vec3, force_range_N: float, torque_range_Nm: float) -> str:
    """Say which axis is at or beyond 95 % of its range, or nothing."""
    ranges = (force_range_N,) * 3 + (torque_range_Nm,) * 3
    for (axis, unit), value, full in zip(AXES, force_N + torque_Nm, ranges, strict=True):
        if abs(value) >= SATURATED_FROM * full:
            return (
                f"{axis} reads {value:.4g} {unit}, "
                f"{SATURATED_FROM:.0%} or more of its range of {full:g} {unit}"
            )
    return ""
