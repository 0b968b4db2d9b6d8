"""Registry of sensor drivers by the cell file's `sensor.driver`: ours, and those of other packages.

A driver is a function `(sensor: SensorSection, *, stale_after_s: float) -> SensorInterface`.
Another package adds one by an entry point in the group `forcemesh.sensor_drivers`.
"""

from importlib.metadata import EntryPoint, entry_points

from common.config.cell import CellConfig
from forcemesh.errors import ConfigError
from services.sensor.driver import SensorInterface

GROUP = "forcemesh.sensor_drivers"
OURS = {
    "rdt": "services.sensor.rdt_driver:rdt_driver",  # ATI Net F/T, ATI Axia, OnRobot
    "robotiq": "services.sensor.robotiq:robotiq_driver",  # FT 300, FT 300-S
    "bota": "services.sensor.bota:bota_driver",
}


def installed_drivers() -> dict[str, EntryPoint]:
    """Return every installed driver by name; a name of ours cannot be taken."""
    ours = [EntryPoint(name, value, GROUP) for name, value in OURS.items()]
    return {each.name: each for each in (*entry_points(group=GROUP), *ours)}


def unknown_driver(cell: CellConfig) -> str:
    """Return the mistake of a cell whose driver is not installed; empty if it needs none."""
    names, chosen = sorted(installed_drivers()), cell.sensor.driver
    if cell.roles.sensor != "driver" or chosen in names:
        return ""
    return (
        f"sensor.driver: {chosen!r} is not installed here, installed: {', '.join(names)}; install "
        f"the package of this driver (its entry point is in {GROUP}), or correct the name"
    )


def refuse_unknown_driver(cell: CellConfig, source: str) -> None:
    """Raise ConfigError with the source when the driver of a cell is not installed."""
    if mistake := unknown_driver(cell):
        raise ConfigError(source, [mistake])


def driver_of(cell: CellConfig, *, stale_after_s: float) -> SensorInterface:
    """Return the driver that a cell file names.

    Raises:
        ConfigError: It is not installed, a package that it needs is missing, or its settings are
            wrong.
    """
    refuse_unknown_driver(cell, "the sensor's driver")
    name = cell.sensor.driver
    try:
        make = installed_drivers()[name].load()
    except (ImportError, AttributeError) as error:
        mistake = f"sensor.driver: {name} cannot be loaded: {error}"
        raise ConfigError("the sensor's driver", [mistake]) from error
    driver: SensorInterface = make(cell.sensor, stale_after_s=stale_after_s)
    return driver
