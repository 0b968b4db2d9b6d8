"""Role `sensor` of a simulated arm: publishes `sensor/wrench` at the sensor rate."""

from common.config.cell import CellConfig
from common.motion.convert import vec3
from common.motion.frames import is_finite
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.messages import SensorWrench
from sim.robot.arm import SimArm
from sim.robot.ft_sensor import FtSample
from sim.robot.settings import TICK_S

CODES = {"ok": "", "saturated": "sensor_saturated", "fault": "sensor_fault"}


class SensorFeed:
    """Publishes a sample every fixed number of ticks of the arm."""

    def __init__(self, sensor_bus: Bus, cell: CellConfig, arm: SimArm) -> None:
        """Claim the sensor topic as publisher."""
        self._arm = arm
        self._ticks = max(1, round(1.0 / cell.rates.sensor_hz / TICK_S))
        self._wrench = sensor_bus.publisher(topics.SENSOR_WRENCH)

    def ticked(self) -> None:
        """Handle one tick of the arm: publish a sample if due."""
        if self._arm.ticks % self._ticks:
            return
        sample = self._arm.ft_sensor.disturb(self._arm.sample_ft())
        if sample is not None:
            self._wrench.put(message_of(sample, self._arm.ticks // self._ticks))


def message_of(sample: FtSample, counter: int) -> SensorWrench:
    """Return a sample as a driver's message; one with non-finite numbers is invalid and empty."""
    force_N, torque_Nm = vec3(sample.force_N), vec3(sample.torque_Nm)
    if not is_finite(force_N + torque_Nm):
        reason = "the sensor reading is not finite"
        return SensorWrench(
            valid=False, reason=reason, code="not_finite", status="fault", counter=counter
        )
    is_ok = sample.status == "ok"
    return SensorWrench(
        valid=is_ok,
        reason="" if is_ok else f"the sensor reports {sample.status}",
        code=CODES[sample.status],
        force_N=force_N,
        torque_Nm=torque_Nm,
        status=sample.status,
        counter=counter,
    )
