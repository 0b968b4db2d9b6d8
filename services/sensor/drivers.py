"""Which driver a cell file asks for: the word `sensor.driver`."""

from common.cell import SensorSection
from services.sensor.driver import Driver
from services.sensor.rdt_driver import rdt_driver


def driver_of(sensor: SensorSection, *, stale_after_s: float) -> Driver:
    """Return the driver of a cell file.

    Raises:
        ConfigError: A package that this driver needs is not there, or its settings are wrong.
    """
    return rdt_driver(sensor, stale_after_s=stale_after_s)
