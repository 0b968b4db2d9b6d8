"""Simulated robot on the bus: implements the keys of the gateway and of the sensor."""

from math import gcd, isfinite

from common.config.cell import CellConfig
from common.motion.arm_check import ArmCheck
from common.robot.service import RobotService
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.messages import ZERO3, SensorWrench, Vec3
from sim.robot.arm import SimArm
from sim.robot.driver import MOST_TICKS_PER_STEP, TICK_NS, SimDriver
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

    It wakes for each command and once per period of its reports, in which it also publishes the
    samples since the last one; for each sample when they are less frequent than the reports, or the
    reports less frequent than the control period.
    """

    driver: SimDriver

    def __init__(self, bus: Bus, cell: CellConfig) -> None:
        """Build the arm of this cell and claim the robot and sensor topics as publisher."""
        driver = SimDriver(cell, bus.clock.now_ns())
        self.arm = driver.arm
        flange_at = self.arm.kinematics.flange_pose
        super().__init__(bus, cell, driver, ArmCheck(cell, flange_at=flange_at))
        self._transport = bus.transport
        self._sensor = sensor = SensorFeed(bus.playing("sensor"), cell, self.arm)
        driver.after_tick.append(sensor.ticked)
        driver.wake_ticks = gcd(driver.state_ticks, sensor.ticks)
        most_ticks = min(MOST_TICKS_PER_STEP, round(1.0 / cell.rates.control_hz / TICK_S))
        if driver.state_ticks % sensor.ticks == 0 and driver.state_ticks <= most_ticks:
            driver.wake_ticks = driver.state_ticks
        self.period_s = driver.wake_ticks * TICK_S
        if (trace := trace_from_environment(self.arm, bus.clock)) is not None:
            driver.after_tick.append(trace.ticked)

    def step(self, now_ns: int) -> None:
        """Execute the command; at its time publish the state, and the samples since the last one.

        The samples go first: the control loop waits for them.
        """
        due_ns = self.due_ns
        with self._transport.gathered():
            try:
                super().step(now_ns)
            finally:
                with self._transport.gathered():
                    if now_ns >= due_ns:
                        self._sensor.publish()

    def counters(self) -> dict[str, int]:
        """Return the counters of commands and of lost time."""
        return super().counters() | {"ticks_lost": self.driver.ticks_lost}

    @property
    def due_ns(self) -> int:
        """Time of the tick of the next message: ticks and messages have one grid."""
        wake_ticks = self.driver.wake_ticks
        return self.driver.time_of((self.arm.ticks // wake_ticks + 1) * wake_ticks)


class SensorFeed:
    """Takes a sample every fixed number of ticks of the arm."""

    def __init__(self, sensor_bus: Bus, cell: CellConfig, arm: SimArm) -> None:
        """Claim the sensor topic as publisher."""
        self._arm, self._clock = arm, sensor_bus.clock
        self._waiting: list[SensorWrench] = []
        self._published_ns = sensor_bus.clock.now_ns()
        self.ticks = max(1, round(1.0 / cell.rates.sensor_hz / TICK_S))
        self._wrench = sensor_bus.publisher(topics.SENSOR_WRENCH)

    def ticked(self) -> None:
        """Handle one tick of the arm: take a sample if due.

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
        message = SensorWrench(
            valid=not reason,
            reason=reason,
            code=code,
            force_N=force_N,
            torque_Nm=torque_Nm,
            status=status,
            counter=self._arm.ticks // self.ticks,
        )
        self._waiting.append(message)

    def publish(self) -> None:
        """Publish the samples taken since the last call, the last of them now.

        The others have the times of their ticks before it, or less apart after a late call: a
        reader divides by the time between two samples.
        """
        now_ns, count = self._clock.now_ns(), len(self._waiting)
        apart_ns = min(self.ticks * TICK_NS, (now_ns - self._published_ns) // max(count, 1))
        for number, message in enumerate(self._waiting, 1):
            self._wrench.put(message, at_ns=now_ns - (count - number) * apart_ns)
        if count:
            self._waiting, self._published_ns = [], now_ns
