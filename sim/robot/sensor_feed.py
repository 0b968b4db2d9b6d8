"""The role `sensor` of a simulated arm: `sensor/wrench` at the sensor's rate, whoever moves it."""

from common import topics
from common.cell import Cell
from common.convert import vec3
from common.endpoints import Bus
from common.messages import SensorWrench
from sim.robot.arm import SimArm
from sim.robot.settings import TICK_S


class SensorFeed:
    """Publishes a reading whenever the arm has made enough ticks."""

    def __init__(self, sensor_bus: Bus, cell: Cell, arm: SimArm) -> None:
        """Take the topic of the sensor."""
        self._arm = arm
        self._ticks = max(1, round(1.0 / cell.rates.sensor_hz / TICK_S))
        self._wrench = sensor_bus.publisher(topics.SENSOR_WRENCH)

    def ticked(self) -> None:
        """The arm has made a tick: publish if a reading is due."""
        if self._arm.ticks % self._ticks:
            return
        sample = self._arm.sample_ft()
        self._wrench.put(
            SensorWrench(
                force_N=vec3(sample.force_N),
                torque_Nm=vec3(sample.torque_Nm),
                status=sample.status,
                counter=self._arm.ticks // self._ticks,
            )
        )
