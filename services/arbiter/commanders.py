"""Ownership of the arm: present commander, pending move, and the command of each period. Pure.

A new owner begins once the robot has reported, under the new turn number, that it is at rest.
Goals start from there, and set points at the measured pose at zero speed, so a hand-over never
causes a jump.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

from common.motion.convert import pose_of, record_of
from forcemesh.clock import NS_PER_S
from forcemesh.faults import refusal, refused, tripped
from forcemesh.messages import Commander, Goal, RegulatorTarget, RobotState, Trip
from forcemesh.requests import MoveRequest, Reply
from services.arbiter.bounds import ArmBounds
from services.arbiter.goals import goal_trip, speed_trip
from services.arbiter.ownership import SETTLE_WITHIN_S, Ownership, PendingMove, Rest
from services.arbiter.ranks import outranks
from services.arbiter.stream import SetpointStream, Tick, begin, braked, follow

NOTHING_TO_DO = "the regulator's target contains no command"


@dataclass(frozen=True, slots=True)
class CommandStep:
    """Command to the robot in this period, and the resulting event."""

    kind: Literal["idle", "goal", "setpoint", "feedback"] = "idle"
    content: dict[str, Any] = field(default_factory=dict)  # of the command
    event: Literal["", "take", "begin", "end"] = ""  # of the table of states
    trips: tuple[Trip, ...] | None = None  # trips to publish from now on; None: unchanged
    stop: Trip | None = None  # why motion must end


class Commanders:
    """Owner of the arm, and at most one pending move."""

    def __init__(self, rest_needed_s: float) -> None:
        """Start without an owner."""
        self.ownership = Ownership()
        self.pending_move: PendingMove | None = None
        self._rest = Rest()
        self._rest_needed_s = rest_needed_s
        self._last_goal_id = 0
        self._regulator_rested = False  # seen stopped since arming and since the last goal

    @property
    def goal_id(self) -> int:
        """Number of the pending move, else of the active one; 0 for none."""
        goal = self.ownership.goal if self.pending_move is None else self.pending_move.goal
        return 0 if goal is None else goal.id

    def update(self, robot: RobotState | None, now_ns: int) -> None:
        """Update the time at rest from a robot state."""
        self._rest = self._rest.update(robot, self.ownership, now_ns)

    def drop(self) -> None:
        """End the active and the pending move: the arm is stopped, or armed again."""
        self.ownership, self.pending_move, self._regulator_rested = (
            self.ownership.next(),
            None,
            False,
        )

    # --- requests ---------------------------------------------------------------------------------

    def ask(
        self, request: MoveRequest, robot: RobotState, bounds: ArmBounds, pending_move: PendingMove
    ) -> tuple[Reply, CommandStep]:
        """Accept or refuse a move; it begins at once if the arm is free and at rest."""
        holder = (
            self.ownership.commander if self.pending_move is None else self.pending_move.commander
        )
        if not outranks(request.commander, holder):
            return refusal("busy", f"the {holder} commands the arm; stop that first"), CommandStep()
        trip = goal_trip(request, robot, bounds) or speed_trip(pending_move.speed, bounds.limits)
        if trip is not None:
            return refused(trip), CommandStep()
        # Above the robot's number too: a restarted arbiter must not repeat one.
        self._last_goal_id = max(self._last_goal_id, robot.goal.id) + 1
        self.pending_move = replace(
            pending_move, goal=pending_move.goal.replaced(id=self._last_goal_id)
        )
        reply = Reply(
            accepted=True,
            text=f"move accepted: goal {self._last_goal_id}",
            value=float(self._last_goal_id),
        )
        return reply, self._take(self.pending_move, holder, robot, bounds)

    def _take(
        self, pending_move: PendingMove, holder: Commander, robot: RobotState, bounds: ArmBounds
    ) -> CommandStep:
        text = f"the {pending_move.commander} took the arm from the {holder}"
        trips = () if holder == "none" else (tripped("preempted", text),)
        if self.ownership.commander != "none":
            self.ownership, self._rest = self.ownership.next(), Rest()
        if self._rests(pending_move.since_ns):
            return self._begin(pending_move, robot, bounds, trips)
        return CommandStep(event="take", trips=trips)

    def _rests(self, now_ns: int) -> bool:
        return self._rest.lasts_s(now_ns) >= self._rest_needed_s

    def _begin(
        self,
        pending_move: PendingMove,
        robot: RobotState,
        bounds: ArmBounds,
        trips: tuple[Trip, ...],
    ) -> CommandStep:
        self.pending_move = None
        trip = goal_trip(
            pending_move.request, robot, bounds
        )  # angles count from where the arm rests
        if trip is not None:
            return CommandStep(event="end", trips=(*trips, tripped("goal_refused", trip.text)))
        ownership = replace(
            self.ownership,
            commander=pending_move.commander,
            goal=pending_move.goal,
            speed=pending_move.speed,
        )
        self.ownership = ownership
        return self._pursue(pending_move.goal, event="begin", trips=trips)

    # --- every period -----------------------------------------------------------------------------

    def step(
        self,
        robot: RobotState,
        target: RegulatorTarget | None,
        bounds: ArmBounds,
        tick: Tick,
        *,
        trips: tuple[Trip, ...],
    ) -> CommandStep:
        """Return the command of this period.

        Args:
            robot: State of the robot.
            target: Proposal of the regulator; None while it is stopped or may not command.
            bounds: Limits of the arm.
            moment: This period.
            trips: Trips published so far.
        """
        if target is None or self.ownership.goal is not None or self.pending_move is not None:
            self._regulator_rested = target is None
        if self.pending_move is not None:
            return self._settle(self.pending_move, robot, bounds, now_ns=tick.now_ns, trips=trips)
        if self.ownership.goal is not None:
            return self._watch(self.ownership.goal, robot)
        if self.ownership.commander == "regulator":
            return self._regulate(target, bounds, tick)
        if target is None or not self._regulator_rested:
            return CommandStep()
        if not self._rests(tick.now_ns):  # the regulator continues from here until it may begin
            return CommandStep(content={"pose": record_of(tick.T_measured), "limited": True})
        stream = begin(tick.T_measured) if target.host == "pc" else None
        self.ownership = replace(
            self.ownership, commander="regulator", host=target.host, stream=stream
        )
        return replace(self._regulate(target, bounds, tick), event="begin", trips=())

    def _settle(
        self,
        pending_move: PendingMove,
        robot: RobotState,
        bounds: ArmBounds,
        *,
        now_ns: int,
        trips: tuple[Trip, ...],
    ) -> CommandStep:
        if self._rests(now_ns):
            return self._begin(pending_move, robot, bounds, trips)
        if now_ns - pending_move.since_ns <= SETTLE_WITHIN_S * NS_PER_S:
            return CommandStep()
        text = (
            f"the arm is not at rest {SETTLE_WITHIN_S:g} s after "
            f"the {pending_move.commander}'s request"
        )
        return CommandStep(stop=tripped("handover", text))

    def _watch(self, goal: Goal, robot: RobotState) -> CommandStep:
        if robot.goal.id != goal.id or robot.goal.state not in {"done", "refused"}:
            return self._pursue(goal)
        refused_goal = (tripped("goal_refused", robot.goal.reason),)
        return self._end(refused_goal if robot.goal.state == "refused" else None)

    def _pursue(self, goal: Goal, **changed: Any) -> CommandStep:
        return CommandStep("goal", {"goal": goal}, **changed)

    def _end(self, trips: tuple[Trip, ...] | None = None) -> CommandStep:
        self.ownership = self.ownership.next()
        return CommandStep(event="end", trips=trips)

    def _regulate(
        self, target: RegulatorTarget | None, bounds: ArmBounds, tick: Tick
    ) -> CommandStep:
        stream = self.ownership.stream
        if target is None and stream is not None and not stream.motion.is_at_rest:
            return self._set_point(braked(stream, bounds, tick.dt_s))  # stopped: ramp down
        if target is None or target.host != self.ownership.host:
            return self._end()
        if stream is None and target.feedback is not None:
            return CommandStep("feedback", {"host": "controller", "feedback": target.feedback})
        if stream is None or target.pose is None:
            return CommandStep(stop=tripped("regulator", NOTHING_TO_DO))
        stream, trip = follow(stream, pose_of(target.pose), bounds, tick)
        return self._set_point(stream) if trip is None else CommandStep(stop=trip)

    def _set_point(self, stream: SetpointStream) -> CommandStep:
        self.ownership, motion = replace(self.ownership, stream=stream), stream.motion
        pose = record_of(motion.T_base_flange)
        return CommandStep("setpoint", {"pose": pose, "limited": motion.lags})
