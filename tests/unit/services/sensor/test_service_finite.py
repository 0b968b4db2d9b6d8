"""A reading of any driver that is not finite: a fault of the sensor, no numbers, no error."""

from collections.abc import Sequence
from math import inf, nan

import pytest

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.messages import ZERO3, Vec3
from services.sensor.driver import SensorSample
from services.sensor.service import SensorDriver
from tests.fakes.bench import Bench
from tests.unit.services.sensor.test_service_serial import PluggedDriver


class BrokenDriver(PluggedDriver):
    """A driver whose reading the test sets."""

    force_N: Vec3 = ZERO3

    def read(self, now_ns: int) -> Sequence[SensorSample]:
        """Return the reading."""
        (sample,) = super().read(now_ns)
        return [sample._replace(force_N=self.force_N)]


@pytest.mark.parametrize("number", [nan, inf, -inf])
def test_a_reading_that_is_not_finite_is_a_fault(number: float) -> None:
    """Published as one, with its axis; the next good reading is published as usual."""
    driver = BrokenDriver()

    def make(bus: Bus, cell: CellConfig) -> SensorDriver:
        return SensorDriver(bus, cell, driver)

    bench = Bench("sensor", make, step_s=0.002)
    driver.force_N = (0.0, number, 0.0)
    message = bench.after_step(topics.SENSOR_WRENCH)
    assert (message.valid, message.status, message.code) == (False, "fault", "sensor_fault")
    assert message.reason == f"Fy reads {number}: not finite"
    assert message.force_N == ZERO3
    driver.force_N = (1.0, 2.0, 3.0)
    assert bench.after_step(topics.SENSOR_WRENCH).force_N == (1.0, 2.0, 3.0)
