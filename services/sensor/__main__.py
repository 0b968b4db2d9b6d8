"""Sensor driver: plays the sensor with an ATI Net F/T, an Axia or an OnRobot over RDT."""

from contextlib import closing

from common.bus import open_bus
from common.priority import take_realtime_priority
from common.service import (
    Runner,
    cell_from_arguments,
    exit_on_error,
    refuse_unless_played_by,
    reporter_of,
    stop_on_signals,
)
from services.sensor.service import SensorDriver


def main() -> None:
    """Run until SIGTERM or SIGINT, then tell the sensor to stop streaming."""
    cell = cell_from_arguments("sensor")
    stop = stop_on_signals()
    take_realtime_priority()
    with exit_on_error("sensor"):
        refuse_unless_played_by(cell, "sensor", "driver")
        with open_bus(cell, "sensor") as bus, closing(SensorDriver(bus, cell)) as driver:
            Runner(driver, [reporter_of(bus, cell)], bus.clock).run(stop)


if __name__ == "__main__":
    main()
