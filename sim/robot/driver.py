"""Command execution of the simulated robot, checked by the same guard as in the gateway. No bus.

A violated limit is a trip and the caller then ends the lease; a rejected goal does not end it.
"""

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.last_check import LastCheck
from common.motion.limits import joint_goal
from common.motion.tracking import TrackingMonitor
from common.motion.unexplained import UnexplainedMotion
from forcemesh.faults import tripped
from forcemesh.messages import (
    Goal,
    GoalReport,
    GoalState,
    Joints,
    PoseRecord,
    RobotCommand,
    Speed,
    Trip,
    WrenchAtTcp,
)
from sim.robot.arm import SimArm
from sim.robot.motion import BUSY, MotionGenerator


class SimDriver:
    """Converts commands into arm motions; rejects commands that violate a limit of the cell."""

    def __init__(self, cell: CellConfig, arm: SimArm, motion: MotionGenerator) -> None:
        """Start at rest."""
        self.goal = GoalReport()
        self.sent: PoseRecord | None = None  # last set point of the stream, flange in base
        self._arm, self._motion = arm, motion
        self._guard = LastCheck(cell, arm.kinematics.flange_pose)
        self._tracking = TrackingMonitor(cell)
        self._resting = UnexplainedMotion(cell)
        self._lease: tuple[int, int] | None = None  # arbiter's epoch, lease
        self._seeded = True

    def hold(self, reason: str) -> None:
        """Brake; once at rest, command the measured pose, so that no command is pending."""
        self._motion.brake()
        self.sent = None
        self._tracking.free()
        self._void(reason)
        if not self._seeded and self._motion.state not in BUSY and not self._arm.moving:
            self._motion.reseed(self._arm.q)
            self._seeded = True

    def obey(
        self,
        command: RobotCommand,
        *,
        lease: tuple[int, int],
        wrench: WrenchAtTcp | None,
        is_new: bool,
        now_ns: int,
    ) -> Trip | None:
        """Execute a permitted command, or return the limit it violates."""
        if lease != self._lease:
            if self._lease is None or lease[0] != self._lease[0]:
                # A new arbiter restarts its goal numbers: its first goal is not an executed one.
                self.goal = GoalReport()
            self._void("armed again")
            self._lease = lease
            self._resting.explain()
            purpose = "all" if command.permission is None else command.permission.purpose
            self._guard.start(self._arm.T_base_flange, now_ns, purpose)
        if (trip := self._guard.wrench(wrench, in_move=command.kind == "goal")) is not None:
            return trip
        self._seeded = False
        if command.kind == "feedback":
            text = "force feedback in the controller requires a controller; this robot has none"
            return tripped("robot_refuses", text)
        if command.kind == "setpoint":
            return self._follow(command, now_ns) if is_new else None
        self.sent = None
        if command.kind == "goal" and command.goal is not None:
            self._pursue(command.goal, command.speed)
            return None
        self._void("the arbiter withdrew the goal")
        moving = self._motion.state in BUSY or self._arm.moving
        self._tracking.rest(self._arm.T_base_flange, moving=moving)
        return None

    def watch(self, T_base_flange: pin.SE3, joint_rad: Joints, now_ns: int) -> Trip | None:
        """Check the measured arm state; called once per report, under permission."""
        return self._guard.arm(T_base_flange, joint_rad, now_ns) or self._tracking.judge(
            T_base_flange, joint_rad, now_ns
        )

    def watch_rest(self, T_base_flange: pin.SE3, now_ns: int) -> Trip | None:
        """Check that an arm that nothing moves stays where it is, until the next lease."""
        commanded = self._motion.state in BUSY or self.sent is not None
        if commanded or self.goal.state == "running" or self._lease is None:
            self._resting.explain()
            return None
        return self._resting.judge(T_base_flange, now_ns)

    def _void(self, reason: str) -> None:
        """Brake a goal that ends other than done; the next one is refused until it is at rest."""
        if self._motion.state == "running":
            self._motion.brake()
        if self.goal.state == "running":
            self.goal = self.goal.replaced(state="refused", reason=reason)

    def _follow(self, command: RobotCommand, now_ns: int) -> Trip | None:
        if command.pose is None:
            return tripped("malformed", "a set point without a pose")
        T_measured = self._arm.T_base_flange
        if self.sent is None:
            if (trip := self._guard.seed(T_measured, now_ns)) is not None:
                return trip
            self._tracking.stream(T_measured, now_ns)
        T_target = pose_of(command.pose)
        if (trip := self._guard.setpoint(T_target, T_measured, now_ns)) is not None:
            return trip
        if reason := self._motion.setpoint(T_target):
            return tripped("robot_refuses", reason)
        self._tracking.stream(T_target, now_ns)
        self.sent = command.pose
        return None

    def _pursue(self, goal: Goal, speed: Speed) -> None:
        if goal.id != self.goal.id:
            self._void("another goal began")
            reason = self._start(goal, speed)
            state: GoalState = "refused" if reason else "running"
            self.goal = GoalReport(id=goal.id, state=state, reason=reason)
        elif self.goal.state == "running" and self._motion.state not in BUSY:
            if self._motion.state == "refused":
                update = {"state": "refused", "reason": self._motion.reason}
                self.goal = self.goal.replaced(**update)
            elif not self._arm.moving:
                self.goal = self.goal.replaced(state="done")

    def _start(self, goal: Goal, speed: Speed) -> str:
        q = self._motion.q_command
        trip = self._guard.goal(goal, speed, self._arm.kinematics.flange_pose(q), q)
        if trip is not None:
            return trip.text
        if goal.kind == "pose" and goal.pose is not None:
            T_goal = pose_of(goal.pose)
            reason = self._motion.start_pose(T_goal, speed)
            if not reason:
                self._tracking.line(self._arm.T_base_flange, T_goal)
            return reason
        q_goal = joint_goal(goal, q)
        reason = self._motion.start_joints(q_goal, speed)
        if not reason:
            self._tracking.joint_move(self._arm.q, q_goal)
        return reason
