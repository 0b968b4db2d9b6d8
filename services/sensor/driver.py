"""Interface of a sensor driver: samples in SI units, and a fault when there are none. Pure.

It also holds the checks that are common to every make.
"""

from collections import deque
from collections.abc import Sequence
from math import isfinite
from typing import Literal, NamedTuple, Protocol

from common.config.cell_sensor import SATURATED_FROM
from forcemesh.messages import ZERO3, Vec3

BAD_SHARE = 0.1  # of the readings of the window
WINDOW = 100
CHANNELS = (("Fx", "N"), ("Fy", "N"), ("Fz", "N"), ("Tx", "N m"), ("Ty", "N m"), ("Tz", "N m"))


class SensorFault(NamedTuple):
    """Fault: a code of forcemesh/faults.py and a text; both empty: no fault."""

    code: str
    text: str


NO_FAULT = SensorFault("", "")


class SensorSample(NamedTuple):
    """Reading in SI units, sensor axes, about the sensor's origin, with its status."""

    force_N: Vec3
    torque_Nm: Vec3
    status: Literal["ok", "saturated", "fault"] = "ok"
    reason: str = ""
    code: str = ""  # of forcemesh/faults.py
    counter: int = 0  # of samples since the driver started, known losses included
    stamp_ns: int = 0  # time of reception, monotonic clock


class Info(NamedTuple):
    """Identity of the sensor; an empty text is unknown."""

    model: str
    force_range_N: float
    torque_range_Nm: float
    calibration: str  # source of the scale from counts to N and N m
    serial: str = ""

    def __str__(self) -> str:
        serial = f" serial {self.serial}" if self.serial else ""
        ranges = f"{self.force_range_N:g} N, {self.torque_range_Nm:g} N m"
        return f"{self.model}{serial}, range {ranges}, {self.calibration}"


class SensorInterface(Protocol):
    """Interface to one make of sensor. It never blocks, and never raises after construction."""

    @property
    def where(self) -> str:
        """Return name and address of the sensor for messages."""

    def read(self, now_ns: int) -> Sequence[SensorSample]:
        """Return every sample received since the last call, oldest first."""

    def silence_fault(self) -> SensorFault:
        """Return why no sample is received at present, as far as the driver knows."""

    def info(self) -> Info | None:
        """Return the identity of the sensor, None while it is unknown."""

    def counters(self) -> dict[str, int]:
        """Return counts of received, lost and dropped samples, by cause."""

    def close(self) -> None:
        """Stop the stream and release the connection."""


def fault_sample(code: str, reason: str) -> SensorSample:
    """Return a sample with a fault and no reading."""
    return SensorSample(ZERO3, ZERO3, "fault", reason, code)


def judged(
    force_N: Vec3, torque_Nm: Vec3, force_range_N: float, torque_range_Nm: float
) -> SensorSample:
    """Return the sample of a reading: saturated when an axis is at 95 % of its range or beyond."""
    ranges = (force_range_N,) * 3 + (torque_range_Nm,) * 3
    for (axis, unit), value, full in zip(CHANNELS, force_N + torque_Nm, ranges, strict=True):
        if abs(value) >= SATURATED_FROM * full:
            text = (
                f"{axis} reads {value:.4g} {unit}, "
                f"{SATURATED_FROM:.0%} or more of its range of {full:g} {unit}"
            )
            return SensorSample(force_N, torque_Nm, "saturated", text, "sensor_saturated")
    return SensorSample(force_N, torque_Nm)


def refused_unless_finite(sample: SensorSample) -> SensorSample:
    """Return a sample, or a fault in its place if one of its numbers is not finite."""
    for (axis, _), value in zip(CHANNELS, sample.force_N + sample.torque_Nm, strict=True):
        if not isfinite(value):
            text = f"{axis} reads {value}: not finite"
            fault = fault_sample("sensor_fault", text)
            return fault._replace(counter=sample.counter, stamp_ns=sample.stamp_ns)
    return sample


class LossWindow:
    """Losses before each of the last readings of a sensor whose losses are not numbered."""

    def __init__(self) -> None:
        """Start without readings."""
        self._lost: deque[int] = deque(maxlen=WINDOW)

    def add(self, lost: int) -> None:
        """Store the number of readings that were lost before another one."""
        self._lost.append(lost)

    def fault(self) -> SensorFault:
        """Return the fault of too many losses."""
        lost, read = sum(self._lost), len(self._lost)
        if read < WINDOW // 2 or lost <= BAD_SHARE * (lost + read):
            return NO_FAULT
        text = f"{lost} of the last {lost + read} readings were lost"
        return SensorFault("sensor_lossy", text)
