"""Decides who may move the arm, and how far. Holds the state; knows neither bus nor clock."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.cell import Cell
from common.clock import NS_PER_S
from common.convert import pose_of, record_of, vec3
from common.faults import clipped, refusal, refused, tripped
from common.frames import Array
from common.limits import Limits, check_step, check_tether, check_workspace, limit_speed
from common.messages import (
    ArbiterState,
    ArbiterStatus,
    Commander,
    Goal,
    Host,
    MoveRequest,
    Permission,
    Purpose,
    RegulatorTarget,
    Reply,
    RobotCommand,
    RobotState,
    Speed,
    Trip,
)
from services.arbiter import inputs as known
from services.arbiter.goals import goal_trip
from services.arbiter.inputs import Inputs
from services.arbiter.preflight import Terms, complaints, lasting
from services.arbiter.reports import lines, recent
from services.arbiter.states import CLEARS, MAY_MOVE, after


@dataclass(frozen=True, slots=True)
class Motion:
    """What the present lease is used for."""

    commander: Commander = "none"
    goal: Goal | None = None
    speed: Speed | None = None  # of this goal, where the move asked for its own
    T_base_flange: pin.SE3 | None = None  # last set point that was let through


IDLE_MOTION = Motion()


class Arbiter:
    """One commander, arm and hold, limits, deadlines."""

    def __init__(self, cell: Cell, *, command_deadline_s: float) -> None:
        """Start in BOOT with nothing known."""
        self.state: ArbiterState = "BOOT"
        self.trips: tuple[Trip, ...] = ()
        self._limits = Limits.of(cell)
        self._deadline_s = command_deadline_s
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self._terms = Terms.of(cell)
        self._speed = Speed()
        self._motion = IDLE_MOTION
        self._lease = 0
        self._lease_since_ns = 0
        self._armed_for: Purpose = "all"
        self._armed_at_m: Array = np.zeros(3)
        self._writers: known.Writers = {}  # of the inputs when the arm was armed
        self._good_since_ns: int | None = None
        self._last_ns = 0
        self._goal_id = 0
        self._regulator_rested = False  # seen stopped since arming and since the last goal
        self._not_ready: list[Trip] = [tripped("not_ready", "starting")]

    # --- every period ---------------------------------------------------------------------------

    def tick(self, inputs: Inputs) -> RobotCommand:
        """Judge the inputs, follow the commander, return what the robot may do."""
        dt_s = (inputs.now_ns - self._last_ns) / NS_PER_S if self._last_ns else 0.0
        self._last_ns = inputs.now_ns
        self._watch_readiness(inputs)
        if self.state in MAY_MOVE:
            self._watch_motion(inputs)
        if self.state in MAY_MOVE:
            return self._follow(inputs, dt_s)
        return RobotCommand(kind="hold", speed=self._speed, reason=self._hold_reason())

    def status(self) -> ArbiterStatus:
        """Return what everybody may know."""
        return ArbiterStatus(
            state=self.state,
            commander=self._motion.commander,
            lease=self._lease,
            armed_for=self._armed_for,
            trips=self.trips,
            not_ready=lines([trip.text for trip in self._not_ready]),
            clears=CLEARS[self.state],
        )

    def _watch_readiness(self, inputs: Inputs) -> None:
        if known.missing(inputs):
            self._good_since_ns = None
        else:
            self._good_since_ns = self._good_since_ns or inputs.now_ns
            self.state = after(self.state, "ready")
        found = complaints(inputs, self._terms, self._good_s(inputs), "all")
        self._not_ready = lasting(found) if self.state in MAY_MOVE else found

    def _good_s(self, inputs: Inputs) -> float:
        since_ns = self._good_since_ns
        return 0.0 if since_ns is None else (inputs.now_ns - since_ns) / NS_PER_S

    def _watch_motion(self, inputs: Inputs) -> None:
        faults = known.fault_trips(inputs) or known.replaced_trips(inputs, self._writers)
        if faults:
            self._stop("fault", *faults)
            return
        p_flange_tcp_m = vec3(np.asarray(self._T_flange_tcp.translation))
        trip = known.limit_trip(inputs, self._limits, p_flange_tcp_m)
        if inputs.robot.fresh is not None:  # a move of the joints has no end pose to judge before
            p_now_m = np.array(inputs.robot.fresh.position_m)
            trip = trip or check_tether(self._limits, self._armed_at_m, p_now_m)
        trip = trip or known.robot_trip(inputs, self._lease_since_ns)
        trip = trip or self._regulator_fails(inputs)
        if trip is not None:
            self._stop("hold", trip)

    def _regulator_fails(self, inputs: Inputs) -> Trip | None:
        target = inputs.target.message
        if self._motion.commander != "regulator" or target is None:
            return None
        if target.valid or target.mode is None:
            return None
        return tripped("regulator", f"the regulator gave up: {target.reason}")

    # --- who commands -----------------------------------------------------------------------------

    def _follow(self, inputs: Inputs, dt_s: float) -> RobotCommand:
        robot, target = inputs.robot.fresh, inputs.target.fresh
        if robot is None:  # cannot be: a stale robot has ended motion above
            return RobotCommand(kind="hold", reason="robot/state is stale")
        if target is None or self._motion.commander == "operator":
            self._regulator_rested = target is None
        if self._motion.commander == "regulator" and target is None:
            self._end()
        elif self._motion.commander == "operator":
            self._watch_goal(robot)
        elif self._may_begin(target):
            self._begin(Motion("regulator", T_base_flange=pose_of(robot)))
        if self._motion.commander == "regulator" and target is not None:
            return self._pass_target(robot, target, dt_s)
        if self._motion.commander == "operator":
            return self._command("goal", goal=self._motion.goal)
        return self._command("idle")

    def _may_begin(self, target: RegulatorTarget | None) -> bool:
        free = self._motion.commander == "none" and self._armed_for == "all"
        return free and target is not None and self._regulator_rested

    def _pass_target(self, robot: RobotState, target: RegulatorTarget, dt_s: float) -> RobotCommand:
        before = self._motion.T_base_flange
        if target.host == "controller" and target.feedback is not None:
            self._motion = Motion("regulator", T_base_flange=pose_of(robot))
            return self._command("feedback", host="controller", feedback=target.feedback)
        if target.host == "controller" or target.pose is None or before is None:
            return self._hold_for(tripped("regulator", "the target holds nothing to do"))
        T_wanted, T_measured = pose_of(target.pose), pose_of(robot)
        T_allowed = limit_speed(self._limits, before, T_wanted, dt_s)
        trip = (
            check_workspace(self._limits, T_allowed * self._T_flange_tcp)
            or check_step(self._limits, T_measured, T_allowed)
            or check_tether(self._limits, self._armed_at_m, np.asarray(T_allowed.translation))
        )
        if trip is not None:
            return self._hold_for(trip)
        self._motion = Motion("regulator", T_base_flange=T_allowed)
        limited = T_allowed is not T_wanted
        return self._command("setpoint", pose=record_of(T_allowed), limited=limited)

    def _watch_goal(self, robot: RobotState) -> None:
        goal = self._motion.goal
        if goal is None or robot.goal.id != goal.id:
            return
        if robot.goal.state == "refused":
            self.trips = (tripped("goal_refused", robot.goal.reason),)
        if robot.goal.state in ("done", "refused"):
            self._end()

    def _begin(self, motion: Motion) -> None:
        self._motion, self.trips = motion, ()
        self.state = after(self.state, "begin")

    def _end(self) -> None:
        self._motion = IDLE_MOTION
        self.state = after(self.state, "end")

    def _stop(self, event: str, *trips: Trip) -> None:
        """Latch. A second cause is added to the first one."""
        latched = self.state not in MAY_MOVE
        self.trips = recent((*self.trips, *trips) if latched else trips)
        self._motion = IDLE_MOTION
        self.state = after(self.state, event)

    def _hold_for(self, trip: Trip) -> RobotCommand:
        self._stop("hold", trip)
        return RobotCommand(kind="hold", speed=self._speed, reason=self._hold_reason())

    def _hold_reason(self) -> str:
        cause = self.trips[-1].text if self.trips else "not armed"
        return clipped(f"the arbiter is {self.state}: {cause}")

    def _command(self, kind: str, *, host: Host = "pc", **content: object) -> RobotCommand:
        permission = Permission(host=host, lease=self._lease, deadline_s=self._deadline_s)
        speed = self._motion.speed or self._speed
        fields = {"kind": kind, "commander": self._motion.commander, "speed": speed}
        return RobotCommand.model_validate({**fields, "permission": permission, **content})

    # --- requests ---------------------------------------------------------------------------------

    def arm(self, inputs: Inputs, purpose: Purpose = "all") -> Reply:
        """Let motion begin, after the preflight; for `jog` no force feedback."""
        robot = inputs.robot.fresh
        if self.state in MAY_MOVE and self._armed_for in ("all", purpose):
            return Reply(accepted=True, code="already", text=f"already {self.state}")
        if self.state in MAY_MOVE:
            return refusal("state", "armed for jog alone: hold, then arm for all")
        if after(self.state, "arm") != "ARMED":
            return refusal("state", f"the arbiter is {self.state}: {CLEARS[self.state]}")
        not_ready = complaints(inputs, self._terms, self._good_s(inputs), purpose)
        if not_ready or robot is None:
            texts = "; ".join(why.text for why in not_ready)
            return refused(not_ready[0].model_copy(update={"text": clipped(texts)}))
        self._armed_for = purpose
        self.state, self.trips, self._motion = after(self.state, "arm"), (), IDLE_MOTION
        self._lease += 1
        self._regulator_rested = False
        self._lease_since_ns = inputs.now_ns
        self._armed_at_m = np.array(robot.position_m)
        self._writers = known.writers(inputs)
        return Reply(accepted=True, text=f"armed, lease {self._lease}")

    def hold(self, reason: str) -> Reply:
        """Stop motion and hold; always accepted."""
        self._stop("hold", tripped("hold", reason))
        return Reply(accepted=True, text=clipped(f"{self.state}: {reason}"))

    def clear(self, inputs: Inputs) -> Reply:
        """Acknowledge a hold or a fault whose cause is gone."""
        if self.state == "FAULT" and (faults := known.fault_trips(inputs)):
            return refused(faults[0])
        self.state = after(self.state, "clear")
        self.trips = () if self.state == "IDLE" else self.trips
        return Reply(accepted=True, text=f"the arbiter is {self.state}")

    def set_speed(self, speed: Speed) -> Reply:
        """Set the speeds of the moves to come."""
        if (trip := self._speed_trip(speed)) is not None:
            return refused(trip)
        self._speed = speed
        real_m_s = speed.mechanical_m_s * speed.modular_fraction
        return Reply(accepted=True, text=f"moves run at {real_m_s * 1e3:.1f} mm/s", value=real_m_s)

    def _speed_trip(self, speed: Speed) -> Trip | None:
        real_m_s = speed.mechanical_m_s * speed.modular_fraction
        if real_m_s <= self._limits.speed_m_s:
            return None
        text = "mechanical times modular speed is above limits.speed_m_s"
        return tripped("speed", text, value=real_m_s, limit=self._limits.speed_m_s)

    def move(self, request: MoveRequest, inputs: Inputs) -> Reply:
        """Give the robot a goal."""
        robot = inputs.robot.fresh
        if self.state not in MAY_MOVE or robot is None:
            text = f"the arbiter is {self.state}: {CLEARS[self.state]}"
            return refusal("not_armed", text)
        if self._motion.commander != "none":
            text = f"the {self._motion.commander} commands the arm; stop that first"
            return refusal("busy", text)
        trip = goal_trip(
            request,
            robot,
            limits=self._limits,
            T_flange_tcp=self._T_flange_tcp,
            armed_at_m=self._armed_at_m,
        )
        if trip is not None:
            return refused(trip)
        speed = self._speed
        if request.speed_m_s is not None:
            own = {"mechanical_m_s": request.speed_m_s, "modular_fraction": 1.0}
            speed = speed.model_copy(update=own)
        if (trip := self._speed_trip(speed)) is not None:
            return refused(trip)
        # Above what the robot reports too: an arbiter that restarted must not repeat a number.
        self._goal_id = max(self._goal_id, robot.goal.id) + 1
        goal = Goal(
            id=self._goal_id, kind=request.kind, pose=request.pose, joint_rad=request.joint_rad
        )
        self._begin(Motion("operator", goal=goal, speed=speed))
        return Reply(accepted=True, text=f"goal {goal.id}", value=float(goal.id))
