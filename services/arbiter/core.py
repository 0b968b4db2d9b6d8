"""Decides who may move the arm, and how far. Holds the state; knows neither bus nor clock."""

from dataclasses import replace

import numpy as np

from common.cell import Cell
from common.clock import NS_PER_S
from common.convert import pose_of, record_of
from common.faults import FAULTS, clipped, refusal, refused, tripped
from common.limits import Limits
from common.messages import (
    MAY_MOVE,
    ArbiterState,
    ArbiterStatus,
    Goal,
    Permission,
    Purpose,
    RobotCommand,
    RobotState,
    Speed,
    Trip,
)
from common.motion_limits import JointTrack
from common.requests import MoveRequest, Reply
from services.arbiter import inputs as known
from services.arbiter import stops
from services.arbiter.bounds import Bounds
from services.arbiter.commanders import Commanders, Step
from services.arbiter.goals import real_speed_m_s, speed_of, speed_trip
from services.arbiter.inputs import Inputs
from services.arbiter.preflight import Terms, complaints, lasting
from services.arbiter.reports import lines, recent, what_next
from services.arbiter.states import CLEARS, after
from services.arbiter.stream import Moment
from services.arbiter.turns import REST_S, Claim

LONGEST_GAP_PERIODS = 3.0  # after a longer one, set points go on as if it had been so long
LEAST_REPORTS = 3.0  # of the robot, in which it must have been at rest


class Arbiter:
    """One commander, arm and hold, limits, deadlines."""

    def __init__(self, cell: Cell, *, command_deadline_s: float) -> None:
        """Start in BOOT with nothing known."""
        self.state: ArbiterState = "BOOT"
        self.trips: tuple[Trip, ...] = ()
        self._deadline_s = command_deadline_s
        self._longest_gap_s = LONGEST_GAP_PERIODS / cell.rates.control_hz
        self._terms, self._retreat = Terms.of(cell), stops.Retreat.of(cell)
        self._bounds = Bounds(Limits.of(cell), cell.tool.T_flange_tcp.pose, np.zeros(3))
        self._commanders = Commanders(max(REST_S, LEAST_REPORTS / cell.rates.robot_hz))
        self._stopping: stops.Stopping | None = None
        self._speed = Speed()
        self._joints = JointTrack()
        self._lease = 0
        self._lease_since_ns = 0
        self._armed_for: Purpose = "all"
        self._writers: known.Writers = {}  # of the inputs when the arm was armed
        self._good_since_ns: int | None = None
        self._last_ns = 0
        self._not_ready: list[Trip] = [tripped("not_ready", "starting")]

    # --- every period ---------------------------------------------------------------------------

    def tick(self, inputs: Inputs) -> RobotCommand:
        """Judge the inputs, follow the commander, return what the robot may do."""
        dt_s = (inputs.now_ns - self._last_ns) / NS_PER_S if self._last_ns else 0.0
        self._last_ns = inputs.now_ns
        self._watch_readiness(inputs)
        self._commanders.see(inputs.robot.fresh, inputs.now_ns)
        if self.state in MAY_MOVE:
            self._watch_motion(inputs)
        command = None
        robot = inputs.robot.fresh
        if self.state in MAY_MOVE and robot is not None:
            moment = Moment(pose_of(robot), inputs.now_ns, min(dt_s, self._longest_gap_s))
            command = self._move_on(robot, inputs, moment)
        return command or RobotCommand(kind="hold", speed=self._speed, reason=self._hold_reason())

    def status(self) -> ArbiterStatus:
        """Return what everybody may know."""
        turn, claim = self._commanders.turn, self._commanders.claim
        return ArbiterStatus(
            state=self.state,
            commander=turn.commander,
            next_commander="none" if claim is None else claim.commander,
            goal_id=self._commanders.goal_id,
            lease=self._lease,
            turn=turn.number,
            armed_for=self._armed_for,
            trips=self.trips,
            not_ready=lines([trip.text for trip in self._not_ready]),
            clears=what_next(self.state, self._not_ready, self._armed_for),
        )

    def _watch_readiness(self, inputs: Inputs) -> None:
        if known.missing(inputs):
            self._good_since_ns = None
        else:
            self._good_since_ns = self._good_since_ns or inputs.now_ns
            if self.state == "BOOT":
                self.trips = known.predecessor_trips(inputs)
            self.state = after(self.state, "ready")
        found = complaints(inputs, self._terms, self._good_s(inputs), "all")
        self._not_ready = lasting(found) if self.state in MAY_MOVE else found

    def _good_s(self, inputs: Inputs) -> float:
        since_ns = self._good_since_ns
        return 0.0 if since_ns is None else (inputs.now_ns - since_ns) / NS_PER_S

    def _watch_motion(self, inputs: Inputs) -> None:
        faults = known.fault_trips(inputs) or known.replaced_trips(inputs, self._writers)
        robot, wrench = inputs.robot, inputs.wrench.fresh
        if faults or robot.fresh is None or robot.header is None or wrench is None:
            self._stop("fault", *faults)
            return
        self._joints = self._joints.after(robot.header.stamp_ns, np.array(robot.fresh.joint_rad))
        bounds = self._bounds
        if self.state == "ACTIVE" and self._commanders.turn.stream is not None:
            bounds = replace(bounds, limits=self._retreat.ceilings(bounds.limits))
        trip = (
            bounds.measured(robot.fresh, wrench, self._joints)
            or known.robot_trip(inputs, self._lease_since_ns)
            or self._regulator_fails(inputs)
            or self._calibration_fails(inputs)
        )
        if trip is not None:
            self._react(trip, inputs)

    def _regulator_fails(self, inputs: Inputs) -> Trip | None:
        target = inputs.target.message
        if self._commanders.turn.commander != "regulator" or target is None:
            return None
        if target.valid or target.mode is None:
            return None
        row = FAULTS.get(target.code)
        code = "regulator" if row is None or row.kind == "REFUSAL" else row.code
        return tripped(code, f"the regulator gave up: {target.reason}")

    def _calibration_fails(self, inputs: Inputs) -> Trip | None:
        by_force = self._commanders.turn.commander == "regulator"
        return inputs.watched.calibration if by_force else None

    def _move_on(self, robot: RobotState, inputs: Inputs, moment: Moment) -> RobotCommand | None:
        """Return what the robot is to do; None when it turned out that it must hold."""
        if self._stopping is not None:
            return self._stop_softly(moment)
        target = inputs.target.fresh
        step = self._commanders.step(
            robot,
            target if self._armed_for == "all" else None,
            self._bounds,
            moment,
            told=self.trips,
        )
        self._note(step)
        if step.stop is None:
            return self._command(step)
        self._react(step.stop, inputs)
        return self._stop_softly(moment)

    def _note(self, step: Step) -> None:
        self.state = after(self.state, step.event)
        self.trips = self.trips if step.told is None else step.told

    def _command(self, step: Step) -> RobotCommand:
        turn = self._commanders.turn
        content = {"host": "pc"} | step.content
        permission = Permission(
            host=content.pop("host"),
            lease=self._lease,
            turn=turn.number,
            deadline_s=self._deadline_s,
        )
        return RobotCommand(
            kind=step.kind,
            commander=turn.commander,
            speed=turn.speed or self._speed,
            permission=permission,
            **content,
        )

    # --- how motion ends --------------------------------------------------------------------------

    def _react(self, trip: Trip, inputs: Inputs) -> None:
        """End motion as the cause asks for: at once, or softly where set points are streamed."""
        if FAULTS[trip.code].kind == "FAULT":
            self._stop("fault", trip)
        elif self._stopping is not None and stops.reaction_to(trip) == "fade":
            return  # it comes to rest already
        elif (soft := self._softly(trip, inputs)) is not None:
            self._stopping, self.trips = soft, (trip,)
            self.state = after(self.state, "soften")
        else:
            self._stop("hold", trip)

    def _softly(self, trip: Trip, inputs: Inputs) -> stops.Stopping | None:
        stream = self._commanders.turn.stream
        if self._stopping is not None or stream is None:
            return None
        return stops.begin(
            trip,
            stream,
            self._bounds,
            retreat=self._retreat,
            wrench=inputs.wrench.fresh,
            now_ns=inputs.now_ns,
        )

    def _stop_softly(self, moment: Moment) -> RobotCommand | None:
        """Let the set points come to rest; None once they have, or when they must not."""
        if self._stopping is None:
            return None
        self._stopping = stopping = stops.step(self._stopping, self._bounds, moment)
        self.trips = (stopping.trip,)
        if stopping.done:
            self._stop("hold")
            return None
        pose = record_of(stopping.pace.T_base_flange)
        return self._command(Step("setpoint", {"pose": pose, "limited": True}))

    def _stop(self, event: str, *trips: Trip) -> None:
        """Latch. A second cause is added to the first one."""
        stopped = self._stopping is not None or self.state not in MAY_MOVE
        self.trips = recent((*self.trips, *trips) if stopped else trips)
        self._commanders.drop()
        self._stopping = None
        self.state = after(self.state, event)

    def _hold_reason(self) -> str:
        cause = self.trips[-1].text if self.trips else "not armed"
        return clipped(f"the arbiter is {self.state}: {cause}")

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
        self._armed_for, self._joints = purpose, JointTrack()
        self._commanders.drop()
        self.state, self.trips = after(self.state, "arm"), ()
        self._lease += 1
        self._lease_since_ns = inputs.now_ns
        self._bounds = replace(self._bounds, armed_at_m=np.array(robot.position_m))
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
        if (trip := speed_trip(speed, self._bounds.limits)) is not None:
            return refused(trip)
        self._speed, real_m_s = speed, real_speed_m_s(speed)
        return Reply(accepted=True, text=f"moves run at {real_m_s * 1e3:.1f} mm/s", value=real_m_s)

    def move(self, request: MoveRequest, inputs: Inputs) -> Reply:
        """Give somebody the arm for a move, as soon as it rests."""
        robot = inputs.robot.fresh
        if self.state not in MAY_MOVE or self._stopping is not None or robot is None:
            return refusal("not_armed", f"the arbiter is {self.state}: {CLEARS[self.state]}")
        goal = Goal(id=0, kind=request.kind, pose=request.pose, joint_rad=request.joint_rad)
        speed = speed_of(request, self._speed)
        claim = Claim(request.commander, request, goal, speed, inputs.now_ns)
        reply, step = self._commanders.ask(request, robot, self._bounds, claim)
        self._note(step)
        return reply
