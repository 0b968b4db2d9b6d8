"""Section `sensor` of a cell file, and the numbers of other sections that its range bounds."""

from collections.abc import Mapping
from typing import Literal

from pydantic import Field, model_validator

from common.config.cell_terms import FrameSection, Positive
from common.config.payload import Payload
from forcemesh.connection import ConfigSection
from forcemesh.units import COUNTS_MOST, LONGEST_SENSOR_LEVER_M, question

SATURATED_FROM = 0.95  # of the range, on any axis: near its end a sensor is no longer linear


class SensorSection(ConfigSection):
    """The force/torque sensor: mounting, range, connection."""

    T_flange_sensor: FrameSection
    axes_given: bool = False  # axes and signs are known to be right, as in a simulation: no check
    force_range_N: float = Field(500.0, gt=0.0, le=10_000.0)
    torque_range_Nm: float = Field(20.0, gt=0.0, le=1000.0)
    frozen_s: float = Field(0.08, ge=0.0, le=0.1)  # longest constant reading; 0: no noise
    driver: str = Field("rdt", min_length=1, max_length=100)  # services/sensor/driver_registry.py
    address: str = "192.168.1.1"
    port: int = Field(49152, ge=1, le=65535)
    counts_per_N: Positive = 1_000_000.0
    counts_per_Nm: Positive = 1_000_000.0
    # Source of the counts: the two above, the sensor's page netftapi2.xml, or both (must agree).
    calibration: Literal["cell", "page", "both"] = "cell"
    page_port: int = Field(80, ge=1, le=65535)
    device: str = "/dev/ttyUSB0"  # robotiq: serial port; bota: configuration file

    @model_validator(mode="after")
    def _ranges_belong_together(self) -> "SensorSection":
        lever_m = self.torque_range_Nm / self.force_range_N
        if lever_m > LONGEST_SENSOR_LEVER_M:
            raise ValueError(
                f"torque_range_Nm {self.torque_range_Nm:g} is that of {self.force_range_N:g} N on "
                f"a lever of {lever_m:.3g} m, at most {LONGEST_SENSOR_LEVER_M:g} m is plausible; "
                "is that in newton millimetres?"
            )
        return self


def sensor_mistake(
    sensor: SensorSection,
    payloads: Mapping[str, Payload],
    limits: Mapping[str, float],
    *,
    is_driven: bool,
) -> str:
    """Return which number of a cell is beyond the sensor's range; empty if none.

    Args:
        sensor: The sensor.
        payloads: Payload and calibration, by their dotted path.
        limits: Limits on force and torque by their dotted path, whose end is the unit.
        is_driven: Whether a driver of ours reads the sensor.
    """
    for where, payload in payloads.items():
        for name, bias, most in (
            ("bias_force_N", payload.bias_force_N, sensor.force_range_N),
            ("bias_torque_Nm", payload.bias_torque_Nm, sensor.torque_range_Nm),
        ):
            worst = max(bias, key=abs)
            if abs(worst) > most:
                asked = question(name, worst, most)
                return f"{where}.{name} is {worst:g}, beyond the sensor's range of {most:g}{asked}"
    for path, limit in limits.items():
        is_force = path.endswith("_N")
        key, unit = ("force_range_N", "N") if is_force else ("torque_range_Nm", "N m")
        full = getattr(sensor, key)
        if limit > SATURATED_FROM * full:
            asked = question(path.split(".")[1], limit, SATURATED_FROM * full)
            return (
                f"{path} is {limit:g} {unit}, at most {SATURATED_FROM * full:g} {unit} is allowed "
                f"({SATURATED_FROM:g} of sensor.{key}, {full:g} {unit}): beyond it the sensor is "
                f"saturated; lower {path}, or mount a sensor with a larger range{asked}"
            )
    if not is_driven or sensor.driver != "rdt":
        return ""
    for name, counts, most in (
        ("counts_per_N", sensor.counts_per_N, sensor.force_range_N),
        ("counts_per_Nm", sensor.counts_per_Nm, sensor.torque_range_Nm),
    ):
        if counts * most > COUNTS_MOST:
            asked = question(name, counts, COUNTS_MOST / most)
            return (
                f"sensor.{name} is {counts:g}: a reading of 32 bits would end at "
                f"{COUNTS_MOST / counts:.3g}, the range is {most:g}{asked}"
            )
    return ""
