"""Ownership of the arm: ranks, present commander, pending move, command of each period. Pure.

A higher rank takes the arm from a lower one; the same or a lower rank is refused as busy. A new
owner begins once the robot has reported, under the new ownership number, that it is at rest. Goals
start from there, and set points at the measured pose at zero speed, so a hand-over never causes a
jump.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from common.motion.arm_check import ArmCheck
from common.motion.convert import pose_of, record_of
from common.motion.joint_paths import move_obstacle
from common.motion.joint_space import JointSpace, JointStream
from common.motion.limits import ArmBounds, slowed
from common.motion.permission import outranks
from common.motion.rate_limiter import CommandedMotion, at_rest, brake
from forcemesh.clock import NS_PER_S
from forcemesh.faults import refusal, refused, tripped
from forcemesh.messages import (
    Asker,
    Commander,
    Feedback,
    Goal,
    Host,
    PoseRecord,
    RegulatorTarget,
    RobotState,
    Speed,
    Trip,
)
from forcemesh.requests import Reply
from services.arbiter.stream import SampleClock, Tick, follow, released

REST_S = 0.1  # time at rest before a hand-over, besides three of the robot's reports
SETTLE_WITHIN_S = 3.0  # longest time from the request to the arm at rest


@dataclass(slots=True)
class Ownership:
    """Ownership period: without an owner at first, then one owner's until its command ends.

    Its number goes out in the permission as a fencing token. The robot echoes it: once the new
    number is reported, no command of the previous owner is in flight.
    """

    number: int = 0
    commander: Commander = "none"
    host: Host = "pc"  # where the regulator runs
    goal: Goal | None = None
    speed: Speed | None = None  # of this goal
    motion: CommandedMotion | None = None  # of the regulator's set points, if streamed
    clock: SampleClock | None = None  # of them
    joints: JointStream | None = None  # of them, if the arm has a model

    def next(self) -> "Ownership":
        """Return the next ownership period, without an owner yet."""
        return Ownership(self.number + 1)


@dataclass(frozen=True, slots=True)
class PendingMove:
    """Pending move, which begins when the arm is at rest."""

    commander: Asker
    goal: Goal
    speed: Speed
    since_ns: int


class CommandStep(NamedTuple):
    """Command to the robot in this period, and the resulting event."""

    kind: Literal["idle", "goal", "setpoint", "feedback"] = "idle"
    goal: Goal | None = None
    pose: PoseRecord | None = None
    limited: bool = False
    feedback: Feedback | None = None
    event: Literal["", "take", "begin", "end"] = ""  # of the table of states
    trips: tuple[Trip, ...] | None = None  # trips to publish from now on; None: unchanged
    stop: Trip | None = None  # why motion must end


class Commanders:
    """Owner of the arm, and at most one pending move."""

    def __init__(self, rest_needed_s: float, space: JointSpace | None = None) -> None:
        """Start without an owner; without a joint space, joints are not checked ahead."""
        self._space = space
        self.ownership = Ownership()
        self.pending_move: PendingMove | None = None
        self.speed_m_s: float | None = None  # limit of streams and force feedback by command 5
        self._rest_since_ns: int | None = None  # reported under the present ownership number
        self._rest_needed_s = rest_needed_s
        self._last_goal_id = 0
        self._regulator_rested = False  # seen stopped since arming and since the last goal

    def update(self, robot: RobotState | None, now_ns: int) -> None:
        """Update the time at rest from a robot state; a robot that holds accepts no owner: no rest.

        A robot that has never accepted a command has no ownership number to compare.
        """
        ownership, rests = self.ownership, False
        if robot is not None and robot.hold is None and ownership.commander == "none":
            is_echoed = robot.accepted is None or robot.accepted.ownership == ownership.number
            rests = is_echoed and not robot.status.moving and robot.status.feedback is None
        if not rests:
            self._rest_since_ns = None
        elif self._rest_since_ns is None:
            self._rest_since_ns = now_ns

    def drop(self) -> None:
        """End the active and the pending move: the arm is stopped, or armed again."""
        self.ownership, self.pending_move = self.ownership.next(), None
        self._regulator_rested = False

    # --- requests ---------------------------------------------------------------------------------

    def ask(
        self, move: PendingMove, robot: RobotState, check: ArmCheck
    ) -> tuple[Reply, CommandStep]:
        """Accept or refuse a move; it begins at once if the arm is free and at rest."""
        holder = (self.pending_move or self.ownership).commander
        if not outranks(move.commander, holder):
            return refusal("busy", f"the {holder} commands the arm; stop that first"), CommandStep()
        trip = self._obstacle(move, robot, check)
        if trip is not None:
            return refused(trip), CommandStep()
        # Above the robot's number too: a restarted arbiter must not repeat one.
        self._last_goal_id = number = max(self._last_goal_id, robot.goal.id) + 1
        self.pending_move = replace(move, goal=move.goal.replaced(id=number))
        text = f"the {move.commander} took the arm from the {holder}"
        trips = () if holder == "none" else (tripped("preempted", text),)
        if self.ownership.commander != "none":
            self.ownership, self._rest_since_ns = self.ownership.next(), None
        step = CommandStep(event="take", trips=trips)
        if self._rests(move.since_ns):
            step = self._begin(self.pending_move, trips)
        text = f"move accepted: goal {number}"
        return Reply(accepted=True, text=text, value=float(number)), step

    def _obstacle(self, move: PendingMove, robot: RobotState, check: ArmCheck) -> Trip | None:
        """Return why a move from here is not permitted, or cannot be followed."""
        trip = check.goal(move.goal, move.speed, pose_of(robot), robot.joint_rad)
        return trip or move_obstacle(self._space, move.goal, robot)

    def _rests(self, now_ns: int) -> bool:
        since_ns = self._rest_since_ns
        return since_ns is not None and (now_ns - since_ns) / NS_PER_S >= self._rest_needed_s

    def _begin(self, move: PendingMove, trips: tuple[Trip, ...]) -> CommandStep:
        self.pending_move = None
        ownership = self.ownership
        ownership.commander, ownership.goal, ownership.speed = move.commander, move.goal, move.speed
        return CommandStep("goal", goal=move.goal, event="begin", trips=trips)

    def _begin_pending(
        self, move: PendingMove, robot: RobotState, check: ArmCheck, trips: tuple[Trip, ...]
    ) -> CommandStep:
        """Begin a move that waited: its path, and angles, count from where the arm rests."""
        trip = self._obstacle(move, robot, check)
        if trip is None:
            return self._begin(move, trips)
        self.pending_move = None
        return CommandStep(event="end", trips=(*trips, tripped("goal_refused", trip.text)))

    # --- every period -----------------------------------------------------------------------------

    def step(
        self,
        robot: RobotState,
        target: RegulatorTarget | None,
        check: ArmCheck,
        tick: Tick,
        *,
        trips: tuple[Trip, ...],
    ) -> CommandStep:
        """Return the command of this period.

        Args:
            robot: State of the robot.
            target: Proposal of the regulator; None while it is stopped or may not command.
            check: Limits of the arm.
            tick: This period.
            trips: Trips published so far.
        """
        move, goal = self.pending_move, self.ownership.goal
        if target is None or goal is not None or move is not None:
            self._regulator_rested = target is None
        if move is not None:
            if self._rests(tick.now_ns):
                return self._begin_pending(move, robot, check, trips)
            if tick.now_ns - move.since_ns <= SETTLE_WITHIN_S * NS_PER_S:
                return CommandStep()
            text = f"the arm is not at rest {SETTLE_WITHIN_S:g} s after the {move.commander}'s"
            return CommandStep(stop=tripped("handover", f"{text} request"))
        if goal is not None:
            if robot.goal.id != goal.id or robot.goal.state not in {"done", "refused"}:
                return CommandStep("goal", goal=goal)
            refused_goal = (tripped("goal_refused", robot.goal.reason),)
            return self._end(refused_goal if robot.goal.state == "refused" else None)
        if self.ownership.commander == "regulator":
            return self._regulate(target, check.bounds, tick)
        if target is None or not self._regulator_rested:
            return CommandStep()
        if not self._rests(tick.now_ns):  # the regulator continues from here until it may begin
            return CommandStep(pose=record_of(tick.T_measured), limited=True)
        self._begin_regulator(robot, target, tick)
        return self._regulate(target, check.bounds, tick)._replace(event="begin", trips=())

    def _begin_regulator(self, robot: RobotState, target: RegulatorTarget, tick: Tick) -> None:
        """Give the arm to the regulator; set points begin at rest, at the measured arm."""
        ownership, space = self.ownership, self._space
        ownership.commander, ownership.host = "regulator", target.host
        if target.host == "pc":
            ownership.motion = at_rest(tick.T_measured)
            if space is not None:
                ownership.joints = space.begin(tick.T_measured, robot.joint_rad)

    def _end(self, trips: tuple[Trip, ...] | None = None) -> CommandStep:
        self.ownership = self.ownership.next()
        return CommandStep(event="end", trips=trips)

    def _regulate(
        self, target: RegulatorTarget | None, bounds: ArmBounds, tick: Tick
    ) -> CommandStep:
        """Follow the regulator; set points of a stopped one are braked first."""
        ownership, motion = self.ownership, self.ownership.motion
        joints = ownership.joints
        followed: CommandedMotion | Trip
        if target is None and motion is not None and not motion.is_at_rest:
            braked, ownership.clock = brake(bounds.limits, motion, tick.dt_s), None
            followed = released(joints, motion, braked, tick.dt_s)
        elif target is None or target.host != ownership.host:
            return self._end()
        elif motion is None and target.feedback is not None:
            feedback = target.feedback
            if self.speed_m_s is not None:
                feedback = feedback.replaced(speed_m_s=self.speed_m_s)
            return CommandStep("feedback", feedback=feedback)
        elif motion is None or target.pose is None:
            text = "the regulator's target contains no command"
            return CommandStep(stop=tripped("regulator", text))
        else:
            clock, stamp_ns, dt_s = ownership.clock, target.wrench_stamp_ns, tick.dt_s
            if clock is not None and stamp_ns is not None:
                ownership.clock, dt_s = clock.next(stamp_ns, tick.now_ns, tick.longest_s)
            elif stamp_ns is not None:
                ownership.clock = SampleClock(stamp_ns, tick.now_ns)
            T_target = pose_of(target.pose)
            # The robot's own speed stays above it: a lower one would delay every set point.
            slow = slowed(bounds, self.speed_m_s)
            followed = follow(motion, T_target, slow, tick, dt_s=dt_s, joints=joints)
        if isinstance(followed, Trip):
            return CommandStep(stop=followed)
        ownership.motion = followed
        pose = record_of(followed.T_base_flange)
        return CommandStep("setpoint", pose=pose, limited=followed.lags)
