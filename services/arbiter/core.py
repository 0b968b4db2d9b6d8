"""Arbiter core: state machine, ownership, limits and permission, without bus or clock."""

from common.config.cell import CellConfig
from common.motion.arm_check import ARBITER_SLACK, ArmCheck
from common.motion.convert import pose_of, record_of
from common.motion.joint_space import JointSpace, checks_off_text
from common.motion.limits import check_speed, check_wrench, real_speed_m_s
from common.motion.unexplained import UNEXPLAINED, UnexplainedMotion, is_guided
from forcemesh.clock import NS_PER_S
from forcemesh.faults import FAULTS, clipped, refusal, refused, tripped
from forcemesh.messages import (
    MAY_MOVE,
    ArbiterState,
    ArbiterStatus,
    ArmPurpose,
    Goal,
    Permission,
    Purpose,
    RobotCommand,
    RobotState,
    Speed,
    Trip,
)
from forcemesh.requests import MoveRequest, Reply
from services.arbiter import backing_off
from services.arbiter import inputs as input_checks
from services.arbiter.backing_off import BackingOff
from services.arbiter.commanders import REST_S, Commanders, CommandStep, PendingMove
from services.arbiter.inputs import Inputs
from services.arbiter.preflight import (
    LEAST_REPORTS,
    NO_LEASE,
    LastLease,
    PreflightSettings,
    failed_checks,
    load_text,
)
from services.arbiter.states import ARMED_TEXTS, CLEARS, TABLE, after, lines, recent, what_next
from services.arbiter.stream import (
    REACTIONS,
    Stopping,
    Tick,
    begin_stop,
    retreat_limits,
    step_stop,
)

OWN_HOLDS = ("hold", "no_lease")  # repeated from the arbiter: the new lease is not received yet
ROBOT_ANSWERS_WITHIN_S = 0.3  # a robot that still holds after this does not accept the lease
FIRST_NUMBERS = (0, 0)  # lease and ownership
LONGEST_GAP_PERIODS = 3.0  # longest period, in nominal ones, over which set points advance


class Arbiter:
    """State machine of the arm: one commander, arm and hold, limits, deadlines."""

    def __init__(
        self,
        cell: CellConfig,
        *,
        command_deadline_s: float,
        numbers: tuple[int, int] = FIRST_NUMBERS,
    ) -> None:
        """Start in BOOT without inputs, after a lease and an ownership number."""
        self.state: ArbiterState = "BOOT"
        self.trips: tuple[Trip, ...] = ()
        self._deadline_s = command_deadline_s
        self._longest_gap_s = LONGEST_GAP_PERIODS / cell.rates.control_hz
        self._settings = PreflightSettings.of(cell)
        self._check = ArmCheck(cell, ARBITER_SLACK)
        self._stream_limits = retreat_limits(self._settings.limits, cell.force)
        self._backing_off: BackingOff | None = None
        self._space = JointSpace.of(cell)
        rest_s = max(REST_S, LEAST_REPORTS / cell.rates.robot_hz)
        self._commanders = Commanders(rest_s, self._space)
        self._stopping: Stopping | None = None
        self._speed = Speed()
        self._resting = UnexplainedMotion(cell)
        self._robot_epoch: int | None = None  # of the robot process
        self._lease, self._commanders.ownership.number = numbers
        self._lease_since_ns = 0
        self._last_lease = NO_LEASE
        self._armed_for: Purpose = "all"
        self._writers: input_checks.Writers = {}  # publishers of the inputs at arming
        self._good_since_ns: int | None = None
        self._blind_since_ns: int | None = None  # good except for sensor and wrench
        self._last_inputs: Inputs | None = None  # at the last tick

    # --- every period ---------------------------------------------------------------------------

    def tick(self, inputs: Inputs) -> RobotCommand:
        """Check the inputs, follow the commander, return the command of this period."""
        now_ns, robot = inputs.now_ns, inputs.robot.fresh
        before, self._last_inputs = self._last_inputs, inputs
        lost = input_checks.missing(inputs)
        lost_blind = lost and input_checks.missing(inputs, blind=True)  # a subset of `lost`
        self._good_since_ns = None if lost else self._good_since_ns or now_ns
        self._blind_since_ns = None if lost_blind else self._blind_since_ns or now_ns
        if self.state == "BOOT" and not lost:
            self.trips = () if self._lease else input_checks.predecessor_trips(inputs)
            self.state = after(self.state, "ready")
        self._commanders.update(robot, now_ns)
        if (trip := self._unexplained(inputs, robot)) is not None:
            self.stop("fault", trip)
        command = None
        if self.state in MAY_MOVE:
            blind = self._backing_off is not None and self._backing_off.blind
            faults = (
                (lost_blind if blind else lost)
                or input_checks.robot_faults(inputs)
                or input_checks.replaced_trips(inputs, self._writers)
            )
            header, unknown = inputs.robot.header, inputs.wrench.fresh is None and not blind
            if faults or robot is None or header is None or unknown:
                self.stop("fault", *faults)
            else:
                dt_s = 0.0 if before is None else (now_ns - before.now_ns) / NS_PER_S
                tick = Tick(
                    pose_of(robot),
                    now_ns,
                    min(dt_s, self._longest_gap_s),
                    self._longest_gap_s,
                    header.stamp_ns,
                )
                command = self._move_on(robot, inputs, tick)
        if command is not None:
            expires_ns = now_ns + round(self._deadline_s * NS_PER_S)
            self._last_lease = self._last_lease._replace(expires_ns=expires_ns)
            return command
        if self.state == "FAULT":
            self.trips = recent((*self.trips, *input_checks.late_error(self.trips, inputs)))
        cause = self.trips[-1].text if self.trips else "not armed"
        reason = clipped(f"the arbiter is {self.state}: {cause}")
        return RobotCommand(kind="hold", speed=self._speed, reason=reason)

    def status(self) -> ArbiterStatus:
        """Return the published status."""
        ownership, pending_move = self._commanders.ownership, self._commanders.pending_move
        goal = (pending_move or ownership).goal
        if self._last_inputs is None:  # why arming would be refused
            not_ready = [tripped("not_ready", "starting")]
        else:
            not_ready = self._failed_checks(self._last_inputs, self._good_since_ns, "all")
        # The robot reports the end of a lease within its deadline: only `arm` waits for it.
        passing = {"wait", "moving"} if self.state in MAY_MOVE else {"wait"}
        not_ready = [trip for trip in not_ready if trip.code not in passing]
        return ArbiterStatus(
            state=self.state,
            commander=ownership.commander,
            next_commander="none" if pending_move is None else pending_move.commander,
            goal_id=0 if goal is None else goal.id,
            lease=self._lease,
            ownership=ownership.number,
            armed_for=self._armed_for,
            trips=self.trips,
            not_ready=lines([trip.text for trip in not_ready]),
            clears=what_next(self.state, not_ready, self._armed_for),
        )

    def _unexplained(self, inputs: Inputs, robot: RobotState | None) -> Trip | None:
        """Return the motion that no accepted command explains, found here or by the robot."""
        header, epoch = inputs.robot.header, self._robot_epoch
        self._robot_epoch = None if header is None else header.epoch
        commanded = self._commanders.ownership.commander != "none" or self._stopping is not None
        if (
            robot is None
            or header is None
            or header.epoch != epoch
            or commanded
            or robot.status.feedback is not None
            or self.state not in (*MAY_MOVE, "HOLDING")
            or is_guided(robot.status.faults)
        ):
            self._resting.explain()
            return None
        if self.state == "HOLDING" and robot.hold is not None and robot.hold.code == UNEXPLAINED:
            return robot.hold
        return self._resting.judge(pose_of(robot), header.stamp_ns)

    def _trip(self, robot: RobotState, inputs: Inputs, tick: Tick) -> Trip | None:
        """Check the measured arm, its load, and what robot and regulator report."""
        wrench, ownership, trip = inputs.wrench.fresh, self._commanders.ownership, None
        if self.state == "ACTIVE" and ownership.motion is not None and wrench is not None:
            trip = check_wrench(self._stream_limits, wrench.force_N, wrench.torque_Nm)
        trip = trip or self._check.wrench(wrench, in_move=ownership.goal is not None)
        trip = trip or self._check.arm(
            tick.T_measured, robot.joint_rad, tick.stamp_ns, now_ns=tick.now_ns
        )
        if trip is None and self._backing_off is not None:
            trip = self._backing_off.freed(tick.T_measured, wrench)
        # A robot that has drawn a new challenge, or still holds: its own checks found a cause.
        leased_s = (inputs.now_ns - self._lease_since_ns) / NS_PER_S
        holds = robot.hold is not None and leased_s >= ROBOT_ANSWERS_WITHIN_S
        if trip is None and (holds or robot.challenge != self._last_lease.challenge):
            trip = _ended_by_robot(robot)
        if trip is not None or ownership.commander != "regulator":
            return trip
        target = inputs.target.message
        if target is None or target.valid or target.mode is None:
            return inputs.monitored.feedback
        row = FAULTS.get(target.code)
        code = "regulator" if row is None or row.kind == "REFUSAL" else row.code
        return tripped(code, f"the regulator gave up: {target.reason}")

    def _move_on(self, robot: RobotState, inputs: Inputs, tick: Tick) -> RobotCommand | None:
        """Check the limits; return the commander's command or the stop's, None for a hold."""
        trip = self._trip(robot, inputs, tick)
        if trip is None and self._stopping is None:
            target = inputs.target.fresh if self._armed_for == "all" else None
            step = self._commanders.step(robot, target, self._check, tick, trips=self.trips)
            if step.event:
                self._note(step)
            if self._backing_off is not None and step.event == "end":
                end = self._backing_off.at_its_end(tick.T_measured, inputs.wrench.fresh)
                self.stop("hold", *(step.trips or (end,)))
                return None
            if step.stop is None:
                return self._command(step)
            trip = step.stop
        if trip is not None:
            self._react(trip, inputs)
        if self._stopping is None:  # held at once
            return None
        self._stopping = stopping = step_stop(self._stopping, self._check.bounds, tick)
        self.trips = (stopping.trip,)
        if stopping.done:
            self.stop("hold")
            return None
        pose = record_of(stopping.motion.T_base_flange)
        return self._command(CommandStep("setpoint", pose=pose, limited=True))

    def _note(self, step: CommandStep) -> None:
        """Apply the event of a step, and its trips."""
        self.state = after(self.state, step.event)
        self.trips = self.trips if step.trips is None else step.trips

    def _command(self, step: CommandStep) -> RobotCommand:
        ownership = self._commanders.ownership
        permission = Permission(
            host=ownership.host,
            lease=self._lease,
            ownership=ownership.number,
            deadline_s=self._deadline_s,
            purpose=self._armed_for,
            challenge=self._last_lease.challenge,
        )
        return RobotCommand(
            kind=step.kind,
            commander=ownership.commander,
            speed=ownership.speed or self._speed,
            permission=permission,
            goal=step.goal,
            pose=step.pose,
            limited=step.limited,
            feedback=step.feedback,
        )

    # --- stops ------------------------------------------------------------------------------------

    def _react(self, trip: Trip, inputs: Inputs) -> None:
        """End motion by the reaction of the cause: at once, or softly for streamed set points."""
        if FAULTS[trip.code].kind == "FAULT":
            self.stop("fault", trip)
            return
        if self._stopping is not None:
            if REACTIONS.get(trip.code) != "fade":  # it is already coming to rest
                self.stop("hold", trip)
            return
        motion, wrench = self._commanders.ownership.motion, inputs.wrench.fresh
        if motion is not None:
            joints = self._commanders.ownership.joints
            start = Stopping(trip, motion, inputs.now_ns, joints=joints)
            self._stopping = begin_stop(
                start, self._check.bounds, self._settings.cell.force, wrench
            )
        if self._stopping is None:
            self.stop("hold", trip)
        else:
            self.trips = (trip,)
            self.state = after(self.state, "soften")

    def stop(self, event: str, *trips: Trip) -> None:
        """Stop and latch. A second cause is added to the first one."""
        stopped = self._stopping is not None or self.state not in MAY_MOVE
        if self._backing_off is not None and self._backing_off.blind:
            event = "fault"  # the unknown force is still a fault
            trips = (*trips, *self._backing_off.unknown)
        self.trips = recent((*self.trips, *trips) if stopped else trips)
        self._commanders.drop()
        self._stopping = self._backing_off = None
        self.state = after(self.state, event)

    # --- requests ---------------------------------------------------------------------------------

    def arm(self, inputs: Inputs, purpose: ArmPurpose = "all") -> Reply:
        """Arm after the preflight; purpose `jog` excludes force feedback."""
        robot = inputs.robot.fresh
        if self.state in MAY_MOVE and self._armed_for in ("all", purpose):
            return Reply(
                accepted=True,
                code="already",
                text=f"was armed already, the arbiter is {self.state}",
            )
        if self.state in MAY_MOVE:
            purpose_text = "jog" if self._armed_for == "jog" else "backing off"
            return refusal("state", f"armed for {purpose_text} alone: hold, then arm for all")
        if after(self.state, "arm") != "ARMED":
            return refusal("state", f"the arbiter is {self.state}: {CLEARS[self.state]}")
        not_ready = self._failed_checks(inputs, self._good_since_ns, purpose)
        if not_ready or robot is None:
            return _refuse_arming(not_ready)
        self._begin_lease(purpose, robot, inputs)
        load = load_text(inputs, self._settings)
        unchecked = checks_off_text(self._space, pose_of(robot), robot.joint_rad)
        forecast = self._settings.forecast if purpose == "all" else ""
        text = f"{ARMED_TEXTS[purpose]} (lease {self._lease}){load}{unchecked}{forecast}"
        return Reply(accepted=True, text=clipped(text))

    def _failed_checks(
        self, inputs: Inputs, good_since_ns: int | None, purpose: Purpose, *, blind: bool = False
    ) -> list[Trip]:
        """Return why the arm must not be armed."""
        return failed_checks(
            inputs, self._settings, good_since_ns, purpose, last=self._last_lease, blind=blind
        )

    def _begin_lease(self, purpose: Purpose, robot: RobotState, inputs: Inputs) -> None:
        self._armed_for, self._backing_off = purpose, None
        self._check = ArmCheck(self._settings.cell, ARBITER_SLACK)  # nothing of the last lease
        self._check.start(pose_of(robot), purpose)
        self._resting.explain()
        self._commanders.drop()
        event = "back_off" if purpose == "back_off" else "arm"
        self.state, self.trips = after(self.state, event), ()
        self._lease += 1
        self._lease_since_ns = inputs.now_ns
        self._last_lease = LastLease(robot.challenge)
        self._writers = input_checks.writers(inputs)

    def back_off(self, inputs: Inputs, *, confirmed: bool) -> Reply:
        """Arm for one goal of the arbiter that frees an arm above a ceiling or outside the box.

        Args:
            inputs: Present snapshot.
            confirmed: Whether a person has agreed to back off without a measured force.
        """
        robot, blind = inputs.robot.fresh, backing_off.is_blind(inputs)
        if "back_off" not in TABLE[self.state]:
            return refusal("state", f"the arbiter is {self.state}: hold first")
        since_ns = self._blind_since_ns if blind else self._good_since_ns
        not_ready = self._failed_checks(inputs, since_ns, "back_off", blind=blind)
        if not_ready or robot is None:
            return _refuse_arming(not_ready)
        plan = backing_off.begin(inputs, robot, self._settings, confirmed=confirmed)
        if isinstance(plan, Trip):
            return refused(plan)
        self._begin_lease("back_off", robot, inputs)
        self._backing_off = plan
        self._check.wrench(plan.wrench)
        move = PendingMove("operator", plan.goal, plan.speed, inputs.now_ns)
        reply, step = self._commanders.ask(move, robot, self._check)
        self._note(step)
        if not reply.accepted:
            self.stop("hold", tripped(reply.code, reply.text))
            return reply
        return reply.replaced(text=f"backing off {plan.plan}")

    def hold(self, reason: str) -> Reply:
        """Stop motion and hold; always accepted."""
        self.stop("hold", tripped("hold", reason))
        return Reply(
            accepted=True, text=clipped(f"the arm holds, the arbiter is {self.state}: {reason}")
        )

    def clear(self, inputs: Inputs) -> Reply:
        """Acknowledge a hold, or a fault without a present cause."""
        if self.state == "FAULT" and (faults := input_checks.fault_trips(inputs)):
            return refused(faults[0])
        self.state = after(self.state, "clear")
        self.trips = () if self.state == "IDLE" else self.trips
        return Reply(accepted=True, text=f"cleared: the arbiter is {self.state}")

    def set_speed(self, speed: Speed) -> Reply:
        """Set the speeds of later moves, and a limit to those of streams and force feedback."""
        if (trip := check_speed(self._settings.limits, speed)) is not None:
            return refused(trip)
        self._speed, real_m_s = speed, real_speed_m_s(speed)
        self._commanders.speed_m_s = real_m_s
        text = f"later moves run at {real_m_s * 1e3:.1f} mm/s, force control no faster"
        return Reply(accepted=True, text=text, value=real_m_s)

    def move(self, request: MoveRequest, inputs: Inputs) -> Reply:
        """Accept or refuse a move; it begins as soon as the arm is at rest."""
        robot = inputs.robot.fresh
        if self.state not in MAY_MOVE or self._stopping is not None or robot is None:
            return refusal("not_armed", f"the arbiter is {self.state}: {CLEARS[self.state]}")
        if self._backing_off is not None:
            return refusal("busy", "the arm is backing off: wait until it has ended, or hold")
        goal = Goal(id=0, kind=request.kind, pose=request.pose, joint_rad=request.joint_rad)
        speed = self._speed
        if request.speed_m_s is not None:
            speed = speed.replaced(mechanical_m_s=request.speed_m_s, modular_fraction=1.0)
        move = PendingMove(request.commander, goal, speed, inputs.now_ns)
        reply, step = self._commanders.ask(move, robot, self._check)
        self._note(step)
        return reply


def _ended_by_robot(robot: RobotState) -> Trip:
    """Return why the robot has ended the lease, or does not accept it."""
    hold = robot.hold or tripped("robot_holds", "it has drawn a new challenge")
    is_own = hold.code in OWN_HOLDS or hold.code not in FAULTS
    code = "robot_holds" if is_own else hold.code
    text = clipped(f"the robot holds: {hold.text}")
    return hold.replaced(code=code, rule=FAULTS[code].rule, text=text)


def _refuse_arming(trips: list[Trip]) -> Reply:
    texts = "; ".join(trip.text for trip in trips)
    return refused(trips[0].replaced(text=clipped(texts)))
