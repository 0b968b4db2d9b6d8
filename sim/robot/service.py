"""The simulated robot on the bus: it takes the gateway's and the sensor's place, key by key."""

import numpy as np
import pinocchio as pin

from common import topics
from common.cell import Cell, SimSection
from common.clock import NS_PER_S
from common.convert import pose_of, record_of, vec6
from common.endpoints import Bus
from common.errors import SimulationError
from common.messages import (
    Goal,
    GoalReport,
    GoalState,
    LinkHealth,
    RobotCommand,
    RobotState,
    RobotStatus,
    Speed,
)
from common.permission import NO_COMMAND_YET, CommandGate, Verdict
from sim.robot.arm import SimArm
from sim.robot.motion import MotionGenerator, MotionSpeed
from sim.robot.sensor_feed import SensorFeed
from sim.robot.settings import TICK_S, SensorSettings, SimSettings
from sim.robot.trace import wanted_trace

MOST_TICKS_PER_STEP = 50  # a process that was held up longer loses simulated time instead
TICK_NS = round(TICK_S * NS_PER_S)


class SimRobot:
    """Obeys `robot/command` under the same permission as the gateway; steps the physics."""

    def __init__(self, bus: Bus, cell: Cell) -> None:
        """Build the arm of this cell and take the topics of robot and sensor."""
        if cell.sim is None:
            raise SimulationError("the cell file has no section `sim`")
        self.period_s = TICK_S
        self.trigger = None
        self.fault = ""
        self.arm = SimArm(sim_settings(cell, cell.sim), seed=cell.sim.seed)
        self._motion = MotionGenerator(self.arm.kinematics, self.arm.q)
        self._gate = CommandGate()
        self._verdict = NO_COMMAND_YET
        self._goal = GoalReport()
        self._arbiter_epoch = 0
        self._target_refused = False
        self._seeded = True
        self._state_ticks = max(1, round(1.0 / cell.rates.robot_hz / TICK_S))
        self._start_ns = bus.clock.now_ns()
        self._ticks_lost = 0
        self._command = bus.reader(topics.ROBOT_COMMAND)
        self._state = bus.publisher(topics.ROBOT_STATE)
        self._sensor = SensorFeed(bus.playing("sensor"), cell, self.arm)
        self._trace = wanted_trace(self.arm, bus.clock)

    def counters(self) -> dict[str, int]:
        """Return what was dropped or lost."""
        superseded = self._command.counters.superseded
        return {"command_superseded": superseded, "ticks_lost": self._ticks_lost}

    def step(self, now_ns: int) -> None:
        """Obey or hold, then let the physics catch up with the clock."""
        self._verdict = self._gate.judge(self._command.read(now_ns), now_ns)
        self._obey(self._verdict)
        elapsed = (now_ns - self._start_ns) // TICK_NS - self.arm.ticks - self._ticks_lost
        self._ticks_lost += max(0, elapsed - MOST_TICKS_PER_STEP)
        for _ in range(min(elapsed, MOST_TICKS_PER_STEP)):
            self._tick()

    def _tick(self) -> None:
        self.arm.command_joints(self._motion.tick(TICK_S))
        self.arm.step()
        self._sensor.ticked()
        if self._trace is not None:
            self._trace.ticked()
        if self.arm.ticks % self._state_ticks == 0:
            self._put_state()

    # --- obeying --------------------------------------------------------------------------------

    def _obey(self, verdict: Verdict) -> None:
        command = verdict.command
        if command is None:
            self._hold()
            return
        self._seeded = False
        if verdict.accepted is not None and verdict.accepted.epoch != self._arbiter_epoch:
            # Another arbiter counts its goals anew: its first one is not the one that was done.
            self._arbiter_epoch, self._goal = verdict.accepted.epoch, GoalReport()
        if command.kind == "goal" and command.goal is not None:
            self._pursue(command.goal, command.speed)
        elif command.kind == "setpoint" and verdict.is_new:
            self._follow(command)
        elif command.kind == "feedback":
            self._refuse("force feedback in the controller needs a controller, this is a bare arm")
        elif command.kind == "idle" and self._motion.state == "running":
            self._motion.brake()

    def _hold(self) -> None:
        """Brake; once at rest, command the measured pose, so that nothing is left to be done."""
        self._motion.brake()
        if self._goal.state == "running":
            self._goal = self._goal.model_copy(
                update={"state": "refused", "reason": self._verdict.hold_reason}
            )
        if not self._seeded and not self._motion.busy and not self.arm.moving:
            self._motion.reseed(self.arm.q)
            self._seeded = True

    def _follow(self, command: RobotCommand) -> None:
        if command.pose is None:
            self._refuse("a set point without a pose")
            return
        reason = self._motion.setpoint(pose_of(command.pose))
        if reason:
            self._refuse(reason)

    def _pursue(self, goal: Goal, speed: Speed) -> None:
        if goal.id != self._goal.id:
            reason = self._start(goal, speed)
            state: GoalState = "refused" if reason else "running"
            self._goal = GoalReport(id=goal.id, state=state, reason=reason)
        elif self._goal.state == "running" and not self._motion.busy:
            if self._motion.state == "refused":
                update = {"state": "refused", "reason": self._motion.reason}
                self._goal = self._goal.model_copy(update=update)
            elif not self.arm.moving:
                self._goal = self._goal.model_copy(update={"state": "done"})

    def _start(self, goal: Goal, speed: Speed) -> str:
        motion_speed = MotionSpeed(
            speed_m_s=speed.mechanical_m_s * speed.modular_fraction,
            accel_fraction=speed.accel_fraction,
            decel_fraction=speed.decel_fraction,
        )
        if goal.kind == "pose" and goal.pose is not None:
            return self._motion.start_pose(pose_of(goal.pose), motion_speed)
        if goal.joint_rad is None:
            return f"a goal of kind {goal.kind} without its numbers"
        if goal.kind == "by":
            return self._motion.start_by(np.array(goal.joint_rad), motion_speed)
        return self._motion.start_joints(np.array(goal.joint_rad), motion_speed)

    def _refuse(self, reason: str) -> None:
        self._target_refused = True
        self._verdict = self._gate.revoke(reason, "robot_refuses")
        self._hold()

    # --- saying ---------------------------------------------------------------------------------

    def _put_state(self) -> None:
        T_base_flange = record_of(self.arm.T_base_flange)
        hold_reason = self._verdict.hold_reason
        self._target_refused = self._target_refused and bool(hold_reason)
        status = RobotStatus(
            motor_power=True,
            repeat_mode=True,
            teach_lock_off=True,
            program_running=True,
            moving=self.arm.moving,
            held=bool(hold_reason),
            target_refused=self._target_refused,
        )
        self._state.put(
            RobotState(
                position_m=T_base_flange.position_m,
                orientation_xyzw=T_base_flange.orientation_xyzw,
                joint_rad=vec6(self.arm.q),
                status=status,
                goal=self._goal,
                accepted=self._verdict.accepted,
                hold_reason=hold_reason,
                hold_code=self._verdict.hold_code,
                link=LinkHealth(connected=True, round_trip_s=0.0),
            )
        )


def sim_settings(cell: Cell, sim: SimSection) -> SimSettings:
    """Return the settings of the simulated cell that a cell file asks for."""
    T_flange_sensor = cell.sensor.T_flange_sensor.pose
    T_sensor_tcp: pin.SE3 = T_flange_sensor.inverse() * cell.tool.T_flange_tcp.pose
    return SimSettings(
        delay_s=sim.delay_s,
        smoothing_s=sim.smoothing_s,
        T_flange_sensor=T_flange_sensor,
        T_sensor_tcp=T_sensor_tcp,
        tool_mass_kg=sim.tool_mass_kg,
        p_sensor_com_m=sim.tool_com_m,
        disc_radius_m=sim.disc_radius_m,
        stiffness_N_m=sim.stiffness_N_m,
        tilt_stiffness_Nm_rad=sim.tilt_stiffness_Nm_rad,
        tilt_deg=sim.tilt_deg,
        gap_m=sim.gap_m,
        sensor=SensorSettings(
            force_noise_N=sim.noise_force_N,
            torque_noise_Nm=sim.noise_torque_Nm,
            force_bias_N=sim.bias_force_N,
            torque_bias_Nm=sim.bias_torque_Nm,
            force_step_N=sim.quantum_force_N,
            torque_step_Nm=sim.quantum_torque_Nm,
            force_range_N=cell.sensor.force_range_N,
            torque_range_Nm=cell.sensor.torque_range_Nm,
        ),
    )
