"""Each sample says which sensor it is of, so that a calibration of another one is found out."""

from collections.abc import Sequence

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus
from services.sensor.driver import NO_FAULT, Info, SensorFault, SensorSample
from services.sensor.service import SensorDriver
from tests.fakes.bench import Bench

STEP_S = 0.002


class Plugged:
    """A driver of whichever sensor is plugged in, if any."""

    where = "a sensor"

    def __init__(self) -> None:
        self.serial: str | None = "FT1"
        self.tells = True
        self._counter = 0

    def read(self, now_ns: int) -> Sequence[SensorSample]:
        """Return one sample while a sensor is plugged in."""
        if self.serial is None:
            return []
        self._counter += 1
        return [
            SensorSample((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), counter=self._counter, stamp_ns=now_ns)
        ]

    def complaint(self) -> SensorFault:
        """Nothing is known."""
        return NO_FAULT

    def info(self) -> Info | None:
        """Return what the sensor says of itself."""
        if self.serial is None or not self.tells:
            return None
        return Info("fake", 100.0, 10.0, "its own", self.serial)

    def counters(self) -> dict[str, int]:
        """Count nothing."""
        return {}

    def close(self) -> None:
        """Nothing to let go."""


def bench_of(driver: Plugged) -> Bench:
    """Return the service with a driver."""

    def make(bus: Bus, cell: CellConfig) -> SensorDriver:
        return SensorDriver(bus, cell, driver)

    return Bench("sensor", make, step_s=STEP_S)


def test_a_number_that_is_known_later_than_the_first_sample_is_told_from_then_on() -> None:
    """The page of a Net F/T is fetched while its records come already."""
    driver = Plugged()
    driver.tells = False
    bench = bench_of(driver)
    assert bench.after_step(topics.SENSOR_WRENCH).serial == ""
    bench.step(5)
    driver.tells = True
    assert bench.after_step(topics.SENSOR_WRENCH).serial == "FT1"


def test_another_sensor_on_the_same_cable_has_another_number() -> None:
    """Unplugged, another one plugged in: from its first sample on."""
    driver = Plugged()
    bench = bench_of(driver)
    assert bench.after_step(topics.SENSOR_WRENCH).serial == "FT1"
    driver.serial = None
    bench.pass_s(1.0)
    driver.serial = "FT2"
    assert bench.after_step(topics.SENSOR_WRENCH).serial == "FT2"
