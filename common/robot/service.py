"""Robot service: the role `robot` for any arm, whose driver is an argument.

It executes `robot/command` under permission and publishes `robot/state`. Permission, limits,
tracking of the command and motion that no command explains are checked here, for every arm alike;
each violation ends the lease.
"""

from typing import NamedTuple

from common.config.cell import CellConfig
from common.motion.arm_check import ArmCheck
from common.motion.convert import pose_of, record_of
from common.motion.limits import joint_goal
from common.motion.permission import NO_COMMAND_YET, CommandGate, GateDecision
from common.motion.tracking import TrackingMonitor
from common.motion.unexplained import UnexplainedMotion
from common.robot.driver import RobotDriver
from common.robot.report import ArmReport
from common.runtime.signal_service import SignalService
from forcemesh import topics
from forcemesh.bus import Bus, Reading
from forcemesh.clock import NS_PER_S
from forcemesh.errors import LocalProtocolError
from forcemesh.faults import clipped, tripped
from forcemesh.messages import (
    Goal,
    GoalReport,
    PoseRecord,
    Purpose,
    RobotCommand,
    RobotState,
    RobotStatus,
    Speed,
    Trip,
    WrenchAtTcp,
)

EARLY = 0.75  # least share of a period between two published reports


class Lease(NamedTuple):
    """What a lease is known by: its number alone could be used again, for another purpose."""

    epoch: int  # of the arbiter
    number: int
    challenge: int
    purpose: Purpose


class RobotService:
    """Service of the role `robot`."""

    period_s = 0.002  # longest time that a report of the arm waits

    def __init__(self, bus: Bus, cell: CellConfig, driver: RobotDriver, check: ArmCheck) -> None:
        """Open the topics of the robot, in hold; `check` has the limits of the cell."""
        self.driver = driver
        self.fault = ""
        self.verdict = NO_COMMAND_YET  # command that is executed now, or why none is
        self.goal = GoalReport()  # the last one
        self._check = check
        self._gate = CommandGate(bus.epoch)
        self._tracking = TrackingMonitor(cell)
        self._resting = UnexplainedMotion(cell)
        self._lease: Lease | None = None  # the last one
        self._setpoint: PoseRecord | None = None  # the last one of a stream that is active
        self._is_held = True  # nothing was passed to the driver since the last hold
        self._has_braked = False  # an unexplained motion under this lease
        self._refusals = 0
        self._state_period_ns = round(NS_PER_S / cell.rates.robot_hz)
        self._published_ns = 0
        self.trigger = self._command = bus.reader(topics.ROBOT_COMMAND)
        self._wrench = bus.reader(topics.WRENCH)
        self._state = bus.publisher(topics.ROBOT_STATE)
        self._signals = SignalService(bus, cell)

    def counters(self) -> dict[str, int]:
        """Return the counters of superseded and refused commands."""
        superseded = self._command.counters.superseded
        return {"command_superseded": superseded, "refusals": self._refusals}

    def step(self, now_ns: int) -> None:
        """Read the arm's reports, execute the command or hold, publish the state.

        Every report is published; without reports the fault, at the usual rate.
        """
        driver = self.driver
        driver.receive(now_ns)
        fault = driver.link_fault
        self.fault = "" if fault is None else fault.text
        self.verdict = self._judge(fault, now_ns)
        if self.verdict.command is None:
            self._hold(self.verdict.hold_reason)
        if self.goal.state == "running":
            self._follow_goal()
        for report in driver.report():
            self._watch(report)
            if fault is None and self._is_due(report.at_ns, EARLY):
                self._state.put(self._robot_state(report))
        if fault is not None and self._is_due(now_ns):
            self._state.put(self._invalid_state(fault))
        hold = self.verdict.hold
        self._signals.step(now_ns, driver.signals(), hold=hold, switch=driver.switch)

    # --- commands ---------------------------------------------------------------------------------

    def _judge(self, fault: Trip | None, now_ns: int) -> GateDecision:
        """Execute a permitted command; any fault ends its lease."""
        verdict = self._gate.judge(self._command.read(now_ns), now_ns)
        if fault is not None:
            if self.driver.measured is None:  # it may be moved unseen
                self._resting.explain()
            return self._gate.revoke(fault)
        command, accepted, arm_fault = verdict.command, verdict.accepted, self.driver.arm_fault
        if command is None or command.permission is None or accepted is None:
            if arm_fault is None:
                return verdict
            # The cause stands before the reason of the ended lease.
            text = clipped(f"{arm_fault.text}; {verdict.hold_reason}")
            return verdict._replace(hold=arm_fault.replaced(text=text))
        if arm_fault is not None:
            return self._gate.revoke(arm_fault)
        try:
            given = command.permission
            lease = Lease(accepted.epoch, given.lease, given.challenge, given.purpose)
            if lease != self._lease:
                self._begin_lease(lease)
            wrench = self._wrench.read(now_ns)
            trip = self._obey(command, wrench, is_new=verdict.is_new, now_ns=now_ns)
            if trip is None:
                self._is_held = False
                self.driver.flush(command, wrench.fresh)
                return verdict
        except LocalProtocolError as error:
            trip = tripped("unsendable", str(error))
        self._refusals += 1
        return self._gate.revoke(trip)

    def _begin_lease(self, lease: Lease) -> None:
        if not self._is_held:  # an arm may measure its own limits from a hold
            self._hold("armed again")
        if self._lease is None or lease.epoch != self._lease.epoch:
            # A new arbiter restarts its goal numbers: its first goal is not an executed one.
            self.goal = GoalReport()
        self._lease, self._has_braked = lease, False
        self._resting.explain()
        self._check.start(self._measured.T_base_flange, lease.purpose)

    @property
    def _measured(self) -> ArmReport:
        """State of an arm without a fault."""
        measured = self.driver.measured
        assert measured is not None  # noqa: S101 - else there is a fault, and no permission
        return measured

    def _obey(
        self, command: RobotCommand, wrench: Reading[WrenchAtTcp], *, is_new: bool, now_ns: int
    ) -> Trip | None:
        """Execute a permitted command, or return the limit that it violates."""
        trip = self._check.wrench(wrench.fresh, in_move=command.kind == "goal")
        if trip is not None:
            return trip
        if command.kind != "setpoint":
            self._setpoint = None
        if command.kind == "feedback":
            return self._feed_back(command, wrench)
        if command.kind == "setpoint":
            return self._stream(command.pose, now_ns) if is_new else None
        if command.kind == "goal" and command.goal is not None:
            self._pursue(command.goal, command.speed)
        else:
            self._idle()
            measured = self._measured
            self._tracking.rest(measured.T_base_flange, moving=measured.moving)
        return None

    def _hold(self, reason: str) -> None:
        """Brake and hold; nothing is resumed."""
        if self._in_progress:
            self.goal = self.goal.replaced(state="refused", reason=reason)
        self._setpoint = None
        self._tracking.free()
        self.driver.hold(begins=not self._is_held)
        self._is_held = True

    def _idle(self) -> None:
        """Brake an active goal: the permission contains no motion."""
        if self._in_progress:
            is_sent, reason = self.goal.state == "running", "the arbiter withdrew the goal"
            self.goal = self.goal.replaced(state="refused", reason=reason)
            if is_sent:
                self._tracking.free()
                self.driver.hold(begins=True)

    def _feed_back(self, command: RobotCommand, wrench: Reading[WrenchAtTcp]) -> Trip | None:
        feedback, permission = command.feedback, command.permission
        if feedback is None or permission is None or permission.host != "controller":
            return tripped("host", "force feedback needs a permission for host controller")
        if wrench.fresh is None or wrench.header is None:
            return tripped(wrench.code or "invalid", wrench.fault)
        if (trip := self._check.feedback(feedback)) is not None:
            return trip
        self._tracking.free()
        self._idle()
        self._is_held = False
        sample = (wrench.header.epoch, wrench.header.seq)
        return self.driver.feed_back(feedback, wrench.fresh, sample)

    # --- goals and set points ---------------------------------------------------------------------

    @property
    def _in_progress(self) -> bool:
        """Whether the goal is neither done nor refused."""
        return self.goal.state in {"queued", "running"}

    def _pursue(self, goal: Goal, speed: Speed) -> None:
        is_same = goal.id == self.goal.id
        if is_same and self.goal.state != "queued":
            return
        if not is_same and self._in_progress:
            self._idle()
            text = "another goal was in progress; it is braked"
            self.goal = GoalReport(id=goal.id, state="refused", reason=text)
            return
        if not self.driver.may_begin(goal.kind):
            self.goal = GoalReport(id=goal.id, state="queued")
            return
        measured = self._measured
        T, joint_rad = measured.T_base_flange, measured.joint_rad
        trip = self._check.goal(goal, speed, T, joint_rad)
        self._is_held = self._is_held and trip is not None
        reason = self.driver.goal(goal, speed) if trip is None else trip.text
        if reason:
            self.goal = GoalReport(id=goal.id, state="refused", reason=clipped(reason))
            return
        self.goal = GoalReport(id=goal.id, state="running")
        if goal.kind == "pose" and goal.pose is not None:
            self._tracking.line(T, pose_of(goal.pose))
        else:
            self._tracking.joint_move(joint_rad, joint_goal(goal, joint_rad))

    def _follow_goal(self) -> None:
        """Update the state of the goal that runs."""
        state, reason = self.driver.goal_state()
        if state != "running":
            self.goal = self.goal.replaced(state=state, reason=clipped(reason))
        if state == "refused":
            self._tracking.free()
            self.driver.hold(begins=True)

    def _stream(self, pose: PoseRecord | None, now_ns: int) -> Trip | None:
        """Follow a set point; the first of a stream is the measured pose, to avoid a jump."""
        if pose is None:
            return tripped("malformed", "a set point without a pose")
        if self._setpoint is None and not self.driver.may_begin("stream"):
            self._idle()
            return None
        T_target, T_measured = pose_of(pose), self._measured.T_base_flange
        if self._setpoint is None:
            if (trip := self._check.seed(T_measured, now_ns)) is not None:
                return trip
            self._is_held = False
            if (trip := self.driver.stream(T_measured, begins=True)) is not None:
                return trip
            self._tracking.stream(T_measured, now_ns)
        trip = self._check.setpoint(T_target, T_measured, now_ns)
        trip = trip or self.driver.stream(T_target, begins=False)
        if trip is None:
            self._tracking.stream(T_target, now_ns)
            self._setpoint = pose
        return trip

    # --- reports ----------------------------------------------------------------------------------

    def _watch(self, report: ArmReport) -> None:
        """Check a report; a violation ends the lease.

        An arm that nothing moves must stay where it is; a finding holds until the next lease.
        Braking is part of the run-out.
        """
        T, at_ns = report.T_base_flange, report.at_ns
        if self.verdict.command is not None:
            trip = self._check.arm(T, report.joint_rad, at_ns)
            if trip := trip or self._tracking.judge(T, report.joint_rad, at_ns):
                self._refusals += 1
                self.verdict = self._gate.revoke(trip)
                self._hold(trip.text)
        is_commanded = self.goal.state == "running" or self._setpoint is not None
        if is_commanded or self._lease is None or self.driver.explains_motion:
            self._resting.explain()
        elif (trip := self._resting.judge(T, at_ns)) is not None:
            if not self._has_braked:
                self._has_braked, self._is_held = True, False
                self._hold(trip.text)
            self.verdict = self._gate.revoke(trip)

    # --- state ------------------------------------------------------------------------------------

    def _is_due(self, at_ns: int, share: float = 1.0) -> bool:
        """Return whether a state is to be published at this time; each one is counted."""
        if at_ns - self._published_ns < share * self._state_period_ns:
            return False
        self._published_ns = at_ns
        return True

    def _invalid_state(self, fault: Trip) -> RobotState:
        return RobotState(
            valid=False,
            reason=fault.text,
            code=fault.code,
            goal=self.goal,
            hold=self.verdict.hold,
            link=self.driver.link,
        )

    def _robot_state(self, report: ArmReport) -> RobotState:
        hold, flange = self.verdict.hold, record_of(report.T_base_flange)
        return RobotState(
            position_m=flange.position_m,
            orientation_xyzw=flange.orientation_xyzw,
            joint_rad=report.joint_rad,
            status=self.driver.status
            or RobotStatus(ready=True, moving=report.moving, held=hold is not None),
            goal=self.goal,
            accepted=self.verdict.accepted,
            sent=None if self._setpoint is None else self.driver.sent(self._setpoint),
            hold=hold,
            link=self.driver.link,
            challenge=self._gate.challenge,
        )
