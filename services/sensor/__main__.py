"""Sensor driver: plays the sensor with an ATI Net F/T, an Axia or an OnRobot over RDT."""

from common.runtime.service import main
from services.sensor.service import SensorDriver

if __name__ == "__main__":
    main("sensor", SensorDriver, player="driver")
