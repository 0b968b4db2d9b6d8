"""Entry point of the sensor driver: force/torque samples of the cell's sensor."""

from common.runtime.service import main
from services.sensor.service import SensorDriver

if __name__ == "__main__":
    main("sensor", SensorDriver, implementation="driver")
