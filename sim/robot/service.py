"""Simulated robot on the bus: implements the keys of the gateway and of the sensor."""

from math import gcd, isfinite

from common.config.cell import CellConfig
from common.motion.convert import record_of
from common.motion.permission import NO_COMMAND_YET, CommandGate
from common.motion.setpoint_monitor import SPEED_MARGIN
from common.runtime.signal_service import SignalService
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S
from forcemesh.messages import (
    ZERO3,
    LinkHealth,
    RobotState,
    RobotStatus,
    SensorWrench,
    Trip,
    Vec3,
)
from sim.robot.arm import SimArm
from sim.robot.driver import SimDriver
from sim.robot.ft_sensor import FtStatus
from sim.robot.motion import MotionGenerator
from sim.robot.settings import TICK_S, SimSettings
from sim.robot.signals import SimSignals
from sim.robot.trace import trace_from_environment

MOST_TICKS_PER_STEP = 50  # a process delayed for longer drops simulated time instead
TICK_NS = round(TICK_S * NS_PER_S)
SENSOR_CODES: dict[FtStatus, str] = {
    "ok": "",
    "saturated": "sensor_saturated",
    "fault": "sensor_fault",
}
_LINK = LinkHealth(connected=True, round_trip_s=0.0)


class SimRobot:
    """Executes `robot/command` under the same permission as the gateway; steps the physics.

    It wakes for each message that it publishes and for each command; the ticks in between are then
    made up, which is cheaper than waking for each.
    """

    def __init__(self, bus: Bus, cell: CellConfig) -> None:
        """Build the arm of this cell and claim the robot and sensor topics as publisher."""
        self.fault = ""
        settings = SimSettings.of(cell)
        self.arm = SimArm(settings, seed=settings.seed)
        stream_m_s = SPEED_MARGIN * cell.limits.speed_m_s
        self._motion = MotionGenerator(self.arm.kinematics, self.arm.q, stream_m_s=stream_m_s)
        self._gate = CommandGate(bus.epoch)
        self.verdict = NO_COMMAND_YET  # permission in force, or the reason for a hold
        self._driver = SimDriver(cell, self.arm, self._motion)
        self._refusals = 0
        self._state_ticks = max(1, round(1.0 / cell.rates.robot_hz / TICK_S))
        self.due_ns = self._start_ns = bus.clock.now_ns()
        self._ticks_lost = 0
        self.trigger = self._command = bus.reader(topics.ROBOT_COMMAND)
        self._wrench = bus.reader(topics.WRENCH)
        self._state = bus.publisher(topics.ROBOT_STATE)
        self.signals = SimSignals(cell)
        self._signal_service = SignalService(bus, cell)
        self._sensor = SensorFeed(bus.playing("sensor"), cell, self.arm)
        self.wake_ticks = gcd(self._state_ticks, self._sensor.ticks)
        self._trace = trace_from_environment(self.arm, bus.clock)

    @property
    def period_s(self) -> float:
        """Time from one message to the next [s]."""
        return self.wake_ticks * TICK_S

    def counters(self) -> dict[str, int]:
        """Return the counters of dropped messages and lost time."""
        return {
            "command_superseded": self._command.counters.superseded,
            "ticks_lost": self._ticks_lost,
            "refusals": self._refusals,
        }

    def step(self, now_ns: int) -> None:
        """Execute the command or hold, and advance the physics to the clock.

        The command acts from the last tick on. A violated limit ends its lease.
        """
        elapsed = (now_ns - self._start_ns) // TICK_NS - self.arm.ticks - self._ticks_lost
        self._ticks_lost += max(0, elapsed - MOST_TICKS_PER_STEP)
        for _ in range(1, min(elapsed, MOST_TICKS_PER_STEP)):
            self._tick()
        self.verdict = verdict = self._gate.judge(self._command.read(now_ns), now_ns)
        command, accepted = verdict.command, verdict.accepted
        if command is not None and command.permission is not None and accepted is not None:
            trip = self._driver.obey(
                command,
                lease=(accepted.epoch, command.permission.lease),
                wrench=self._wrench.read(now_ns).fresh,
                is_new=verdict.is_new,
                now_ns=now_ns,
            )
            if trip is not None:
                self._refuse(trip)
        if self.verdict.command is None:
            self._driver.hold(self.verdict.hold_reason)
        if elapsed > 0:
            self._tick()
        self._signal_service.step(
            now_ns, self.signals.reading(), hold=self.verdict.hold, switch=self.signals.switch
        )
        # The tick of the next message: ticks and messages have one grid.
        next_tick = (self.arm.ticks // self.wake_ticks + 1) * self.wake_ticks
        self.due_ns = self._start_ns + (next_tick + self._ticks_lost) * TICK_NS

    def _tick(self) -> None:
        self.arm.command_joints(self._motion.tick(TICK_S))
        self.arm.step()
        self._sensor.ticked()
        if self._trace is not None:
            self._trace.ticked()
        if self.arm.ticks % self._state_ticks:
            return
        T_base_flange, joint_rad = self.arm.T_base_flange, tuple(self.arm.q.tolist())
        at_ns = self._start_ns + (self.arm.ticks + self._ticks_lost) * TICK_NS
        trip = self._driver.watch_rest(T_base_flange, at_ns)
        if trip is None and self.verdict.command is not None:
            trip = self._driver.watch(T_base_flange, joint_rad, at_ns)
        if trip is not None:
            self._refuse(trip)
        flange, hold = record_of(T_base_flange), self.verdict.hold
        self._state.put(
            RobotState(
                position_m=flange.position_m,
                orientation_xyzw=flange.orientation_xyzw,
                joint_rad=joint_rad,
                status=RobotStatus(ready=True, moving=self.arm.moving, held=hold is not None),
                goal=self._driver.goal,
                accepted=self.verdict.accepted,
                sent=self._driver.sent,
                hold=hold,
                link=_LINK,
                challenge=self._gate.challenge,
            )
        )

    def _refuse(self, trip: Trip) -> None:
        """End the lease."""
        self._refusals += 1
        self.verdict = self._gate.revoke(trip)
        self._driver.hold(self.verdict.hold_reason)


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
