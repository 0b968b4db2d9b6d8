"""Registry of sensor drivers by the cell file's `sensor.driver`."""

from collections.abc import Callable

from common.config.cell import SensorSection
from services.sensor.bota import bota_driver
from services.sensor.driver import SensorInterface
from services.sensor.rdt_driver import rdt_driver
from services.sensor.robotiq_driver import robotiq_driver

DRIVERS: dict[str, Callable[..., SensorInterface]] = {
    "rdt": rdt_driver,  # ATI Net F/T, ATI Axia, OnRobot
    "robotiq": robotiq_driver,  # FT 300, FT 300-S
    "bota": bota_driver,
}


def driver_of(sensor: SensorSection, *, stale_after_s: float) -> SensorInterface:
    """Return the driver that a cell file names.

    Raises:
        ConfigError: A package that this driver needs is missing, or its settings are wrong.
    """
    return DRIVERS[sensor.driver](sensor, stale_after_s=stale_after_s)
