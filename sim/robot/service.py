"""Simulated robot on the bus: implements the keys of the gateway and of the sensor."""

from math import gcd, isfinite

from common.config.cell import CellConfig
from common.motion.arm_check import ArmCheck
from common.robot.service import RobotService
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.messages import ZERO3, SensorWrench, Vec3
from sim.robot.arm import SimArm
from sim.robot.driver import SimDriver
from sim.robot.ft_sensor import FtStatus
from sim.robot.settings import TICK_S
from sim.robot.trace import trace_from_environment

SENSOR_CODES: dict[FtStatus, str] = {
    "ok": "",
    "saturated": "sensor_saturated",
    "fault": "sensor_fault",
}


class SimRobot(RobotService):
    """Robot service with the simulated arm, and the sensor on it.

    It wakes for each message that it publishes and for each command.
    """

    driver: SimDriver

    def __init__(self, bus: Bus, cell: CellConfig) -> None:
        """Build the arm of this cell and claim the robot and sensor topics as publisher."""
        driver = SimDriver(cell, bus.clock.now_ns())
        self.arm = driver.arm
        flange_at = self.arm.kinematics.flange_pose
        super().__init__(bus, cell, driver, ArmCheck(cell, flange_at=flange_at))
        sensor = SensorFeed(bus.playing("sensor"), cell, self.arm)
        driver.after_tick.append(sensor.ticked)
        self.wake_ticks = gcd(driver.state_ticks, sensor.ticks)
        self.period_s = self.wake_ticks * TICK_S
        if (trace := trace_from_environment(self.arm, bus.clock)) is not None:
            driver.after_tick.append(trace.ticked)

    def counters(self) -> dict[str, int]:
        """Return the counters of commands and of lost time."""
        return super().counters() | {"ticks_lost": self.driver.ticks_lost}

    @property
    def due_ns(self) -> int:
        """Time of the tick of the next message: ticks and messages have one grid."""
        return self.driver.time_of((self.arm.ticks // self.wake_ticks + 1) * self.wake_ticks)


class SensorFeed:
    """Publishes a sample every fixed number of ticks of the arm."""

    def __init__(self, sensor_bus: Bus, cell: CellConfig, arm: SimArm) -> None:
        """Claim the sensor topic as publisher."""
        self._arm = arm
        self.ticks = max(1, round(1.0 / cell.rates.sensor_hz / TICK_S))
        self._wrench = sensor_bus.publisher(topics.SENSOR_WRENCH)

    def ticked(self) -> None:
        """Handle one tick of the arm: publish a sample if due.

        It is the message of a driver: with a number that is not finite it is invalid and empty.
        """
        if self._arm.ticks % self.ticks:
            return
        sample = self._arm.ft_sensor.disturb(self._arm.ft_sensor.sample())
        if sample is None:
            return
        force_N: Vec3 = tuple(sample.force_N.tolist())
        torque_Nm: Vec3 = tuple(sample.torque_Nm.tolist())
        status, code, reason = sample.status, SENSOR_CODES[sample.status], ""
        if not all(map(isfinite, force_N + torque_Nm)):
            force_N = torque_Nm = ZERO3
            status, code, reason = "fault", "not_finite", "the sensor reading is not finite"
        elif status != "ok":
            reason = f"the sensor reports {status}"
        self._wrench.put(
            SensorWrench(
                valid=not reason,
                reason=reason,
                code=code,
                force_N=force_N,
                torque_Nm=torque_Nm,
                status=status,
                counter=self._arm.ticks // self.ticks,
            )
        )
