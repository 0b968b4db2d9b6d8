"""The serial number in each sample, which shows a calibration of another sensor."""

from collections.abc import Sequence

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus
from services.sensor.driver import NO_FAULT, Info, SensorFault, SensorSample
from services.sensor.service import SensorDriver
from tests.fakes.bench import Bench

STEP_S = 0.002


class PluggedDriver:
    """A driver of the sensor that is plugged in, if any."""

    where = "a sensor"

    def __init__(self) -> None:
        self.serial: str | None = "FT1"
        self.has_info = True
        self._counter = 0

    def read(self, now_ns: int) -> Sequence[SensorSample]:
        """Return one sample while a sensor is plugged in."""
        if self.serial is None:
            return []
        self._counter += 1
        return [
            SensorSample((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), counter=self._counter, stamp_ns=now_ns)
        ]

    def silence_fault(self) -> SensorFault:
        """Return no fault."""
        return NO_FAULT

    def info(self) -> Info | None:
        """Return the sensor's own description."""
        if self.serial is None or not self.has_info:
            return None
        return Info("fake", 100.0, 10.0, "its own", self.serial)

    def counters(self) -> dict[str, int]:
        """Count nothing."""
        return {}

    def close(self) -> None:
        """Release nothing."""


def bench_of(driver: PluggedDriver) -> Bench:
    """Return a bench of the service with this driver."""

    def make(bus: Bus, cell: CellConfig) -> SensorDriver:
        return SensorDriver(bus, cell, driver)

    return Bench("sensor", make, step_s=STEP_S)


def test_a_serial_number_read_after_the_first_sample_is_published_from_then_on() -> None:
    """The page of a Net F/T is fetched while its records already arrive."""
    driver = PluggedDriver()
    driver.has_info = False
    bench = bench_of(driver)
    assert bench.after_step(topics.SENSOR_WRENCH).serial == ""
    bench.step(5)
    driver.has_info = True
    assert bench.after_step(topics.SENSOR_WRENCH).serial == "FT1"


def test_another_sensor_on_the_same_cable_has_another_number() -> None:
    """After a change of sensors the first sample has the new serial number."""
    driver = PluggedDriver()
    bench = bench_of(driver)
    assert bench.after_step(topics.SENSOR_WRENCH).serial == "FT1"
    driver.serial = None
    bench.pass_s(1.0)
    driver.serial = "FT2"
    assert bench.after_step(topics.SENSOR_WRENCH).serial == "FT2"
