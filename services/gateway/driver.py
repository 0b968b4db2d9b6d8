"""Command driver: converts permitted commands to packets after the last limit check. No socket.

A refusal is a trip, after which the caller holds. Packets that the dialogue has numbered are
sent at once, also when a refusal follows: IDs have no gaps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import dist

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import plus
from common.motion.last_check import LastCheck
from common.motion.limits import LEVER_M, share_at
from common.motion.tracking import TrackingMonitor
from common.motion.unexplained import REACH, Reach, UnexplainedMotion
from controller.packet_table import Com, Status
from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S
from forcemesh.errors import LocalProtocolError
from forcemesh.faults import tripped
from forcemesh.messages import (
    Feedback,
    Goal,
    GoalReport,
    RobotCommand,
    Speed,
    Trip,
    Vec3,
    WrenchAtTcp,
)
from services.gateway import goals
from services.gateway.dialogue import Dialogue
from services.gateway.goals import ControllerReport, Track
from services.gateway.setpoint_shaper import SetpointShaper

FEEDBACK_STARTS_WITHIN_S = 1.0
CENTRE_STEP_M = 3e-3  # travel of the contact point below which no command is sent


@dataclass(slots=True)
class RunningFeedback:
    """Force feedback requested from the controller."""

    feedback: Feedback
    since_ns: int
    lever_m: Vec3  # sent to the controller last


def slow_setpoint(feedback: Feedback, wrench: WrenchAtTcp) -> tuple[Vec3, Vec3]:
    """Return the set point [N, N m], nearer to the reading where it would be too fast."""
    gains, fastest = feedback.gains, feedback.speed_m_s
    force, torque = feedback.setpoint_force_N, feedback.setpoint_torque_Nm
    if fastest is None:
        return force, torque
    parts = (
        (wrench.force_N, force, gains.force_i_m_per_Ns, fastest),
        (wrench.torque_Nm, torque, gains.torque_i_rad_per_Nms, fastest / LEVER_M),
    )
    nearer = []
    for reading, setpoint, gain, speed in parts:
        share = share_at(speed, plus(reading, setpoint, -1.0), gain)
        nearer.append(plus(reading, plus(setpoint, reading, -1.0), share))
    return nearer[0], nearer[1]


class Driver:
    """Execution of permitted commands: goals, set points, force feedback; and hold."""

    def __init__(
        self,
        cell: CellConfig,
        dialogue: Dialogue,
        send: Callable[[bytes, int], None],
        *,
        guard: LastCheck,
        shaper: SetpointShaper,
        reach: Reach = REACH,
    ) -> None:
        """Start in hold, with nothing sent; `send` takes bytes and the time [ns]."""
        self._reach = reach
        self._dialogue = dialogue
        self._send = send
        self._guard = guard
        self._shaper = shaper
        self._tracking = TrackingMonitor(cell)
        self._resting = UnexplainedMotion(cell)
        self._T_flange_tcp: pin.SE3 = cell.tool.T_flange_tcp.pose
        # The largest speed at which the controller follows set points.
        self._stream_speed = Speed(mechanical_m_s=cell.limits.speed_m_s)
        self.track = Track()  # of the last goal
        self._running: RunningFeedback | None = None
        self._streaming = False  # a stream is active; its first set point was the measured pose
        self._stream_from = 0  # packet number of that set point
        self._holding = True  # every connection begins with hello and hold
        self._has_braked = False  # an unexplained motion under this lease
        self._lease: tuple[int, int] | None = None
        self._last_wrench: tuple[int, int] | None = None
        self._shows_wrench = cell.gateway is not None and cell.gateway.send_wrench
        self._show_period_ns = round(NS_PER_S / cell.rates.status_hz)
        self._shown_ns = 0

    @property
    def sent(self) -> pin.SE3 | None:
        """Last set point sent of the stream, flange in base; None: no stream."""
        return self._shaper.last if self._streaming else None

    def disconnected(self) -> None:
        """Register a lost connection: a new one begins in hold."""
        self._holding = True

    def hold(self, reason: str, now_ns: int) -> None:
        """Brake and hold: command 8 once; nothing is resumed."""
        if self.track.in_progress:
            self.track = self.track.ended("refused", reason)
        self._running, self._streaming = None, False
        self._shaper.end()
        self._tracking.free()
        if not self._holding and self._dialogue.ready:
            self._holding = True
            self._send(self._dialogue.hold(now_ns), now_ns)

    def watch(self, measured: ControllerReport, now_ns: int) -> Trip | None:
        """Check a new report under permission; return why the lease ends."""
        joint_rad, T = measured.joint_rad, measured.T_base_flange
        trip = self._guard.arm(T, joint_rad, now_ns)
        is_refused = self._streaming and measured.status & Status.TARGET_REFUSED
        if trip is None and is_refused and measured.taken >= self._stream_from:
            trip = tripped("robot_refuses", "the controller refused a set point")
        return trip or self._tracking.judge(T, joint_rad, now_ns)

    def watch_rest(
        self, measured: ControllerReport | None, *, guided: bool, now_ns: int
    ) -> Trip | None:
        """Check that an arm that nothing moves stays where it is; a finding holds until a lease.

        `guided`: a person may move the arm. Braking is part of the run-out.
        """
        commanded = self.track.report.state == "running" or self._streaming or self._running
        is_fed_back = self._dialogue.feedback_active
        if measured is None or guided or commanded or is_fed_back or self._lease is None:
            self._resting.explain()
            return None
        trip = self._resting.judge(measured.T_base_flange, measured.at_ns)
        if trip is not None and not self._has_braked:
            self._has_braked, self._holding = True, False
            self.hold(trip.text, now_ns)
        return trip

    def follow_goal(self, measured: ControllerReport, now_ns: int) -> None:
        """Update the state of the goal from a report."""
        if self.track.report.state == "running":
            self.track = goals.follow(self.track, measured, now_ns)
            if self.track.report.state == "refused":
                self._void(now_ns)

    def obey(
        self,
        command: RobotCommand,
        measured: ControllerReport,
        *,
        lease: tuple[int, int],
        wrench: Reading[WrenchAtTcp],
        is_new: bool,
        now_ns: int,
    ) -> Trip | None:
        """Execute a permitted command, or return why it is refused.

        It violates a limit of this cell or is not possible now. Raises LocalProtocolError when it
        does not fit into a packet.
        """
        if lease != self._lease:
            if not self._holding:  # the controller measures rotation from a hold, the guard here
                self.hold("armed again", now_ns)
            self._lease, self.track, self._has_braked = lease, Track(), False
            self._resting.explain()
            purpose = "all" if command.permission is None else command.permission.purpose
            self._guard.start(measured.T_base_flange, now_ns, purpose)
        self._holding = False
        trip = self._guard.wrench(wrench.fresh, in_move=command.kind == "goal")
        if trip is not None:
            return trip
        if command.kind != "setpoint":
            self._streaming = False
            self._shaper.end()
        if command.kind == "feedback":
            return self._obey_feedback(command, wrench, now_ns)
        if self._running is not None:
            self._end_feedback(now_ns)
        self._show(wrench.fresh, now_ns)
        if command.kind == "setpoint":
            return self._stream(command, measured, now_ns) if is_new else None
        if command.kind == "goal" and command.goal is not None:
            self._pursue(command.goal, command.speed, measured, now_ns)
        else:
            self._idle(now_ns)
            moving = bool(measured.status & Status.MOVING)
            self._tracking.rest(measured.T_base_flange, moving=moving)
        return None

    # --- goals and set points ---------------------------------------------------------------------

    def _pursue(self, goal: Goal, speed: Speed, measured: ControllerReport, now_ns: int) -> None:
        track = self.track
        if goal.id == track.report.id and track.report.state != "queued":
            return
        if goal.id != track.report.id and track.in_progress:
            self._idle(now_ns)
            self.track = goals.refused(goal, "another goal was in progress; it is braked")
            return
        # The end of a relative move needs a known start.
        at_rest = self._dialogue.settled and not measured.status & Status.MOVING
        if not self._may_begin or (goal.kind == "by" and not at_rest):
            self.track = Track(GoalReport(id=goal.id, state="queued"))
            return
        trip = self._guard.goal(goal, speed, measured.T_base_flange, measured.joint_rad)
        if trip is not None:
            self.track = goals.refused(goal, trip.text)
        else:
            self._send(self._goal_bytes(goal, speed, now_ns), now_ns)
            self._shaper.moved_otherwise()
            packet, start_rad = self._dialogue.window.last, measured.joint_rad
            track = goals.sent(goal, packet, start_rad, now_ns, reach=self._reach)
            if track.T_target is not None:
                self._tracking.line(measured.T_base_flange, track.T_target)
            else:
                target_rad = track.joint_target_rad or measured.joint_rad
                self._tracking.joint_move(measured.joint_rad, target_rad)
            self.track = track

    def _goal_bytes(self, goal: Goal, speed: Speed, now_ns: int) -> bytes:
        if goal.kind == "pose" and goal.pose is not None:
            return self._dialogue.move_to_pose(pose_of(goal.pose), speed, now_ns)
        if goal.joint_rad is None:  # pragma: no cover - the guard has refused it before
            raise LocalProtocolError(f"a goal of kind {goal.kind} without its numbers")
        com = Com.MOVE_BY_JOINTS if goal.kind == "by" else Com.MOVE_JOINTS
        return self._dialogue.move_joints(com, goal.joint_rad, speed, now_ns)

    def _stream(
        self, command: RobotCommand, measured: ControllerReport, now_ns: int
    ) -> Trip | None:
        """Offer a set point; the first of a stream is the measured pose, to avoid a jump."""
        if command.pose is None:
            return tripped("malformed", "a set point without a pose")
        if not self._streaming and not self._may_begin:
            self._idle(now_ns)
            return None
        T_measured = measured.T_base_flange
        if not self._streaming:
            trip = self._shaper.seed(T_measured, now_ns) or self._guard.seed(T_measured, now_ns)
            if trip is not None:
                return trip
            self._tracking.stream(T_measured, now_ns)
            self._send(self._dialogue.set_speed(self._stream_speed, now_ns), now_ns)
            self._dialogue.offer_setpoint(T_measured)
            self._send(self._dialogue.tick(now_ns, permitted=True), now_ns)
            self._streaming, self._stream_from = True, self._dialogue.window.last
        T_target = pose_of(command.pose)
        trip = self._guard.setpoint(T_target, T_measured, now_ns)
        if trip is None:
            self._dialogue.offer_setpoint(T_target)
            self._tracking.stream(T_target, now_ns)
        return trip

    def _show(self, wrench: WrenchAtTcp | None, now_ns: int) -> None:
        """Offer the wrench for a display in the controller, at the rate of a status."""
        is_due = self._shows_wrench and now_ns - self._shown_ns >= self._show_period_ns
        if is_due and wrench is not None and not self._dialogue.feedback_active:
            self._shown_ns = now_ns
            self._dialogue.show_wrench(wrench.force_N, wrench.torque_Nm)

    def _idle(self, now_ns: int) -> None:
        """Brake an active goal: the permission contains no motion."""
        if self.track.in_progress:
            is_sent = self.track.report.state == "running"
            self.track = self.track.ended("refused", "the arbiter withdrew the goal")
            if is_sent:
                self._void(now_ns)

    def _void(self, now_ns: int) -> None:
        """Brake, and void the packet of a goal that ended other than done, by a hold after it."""
        self._tracking.free()
        self._send(self._dialogue.hold(now_ns), now_ns)

    @property
    def _may_begin(self) -> bool:
        """Whether nothing before can move the arm: hold taken, arm at rest, feedback ended."""
        return self._dialogue.may_begin and not self._dialogue.feedback_active

    # --- force feedback ---------------------------------------------------------------------------

    def _obey_feedback(
        self, command: RobotCommand, wrench: Reading[WrenchAtTcp], now_ns: int
    ) -> Trip | None:
        feedback, permission, running = command.feedback, command.permission, self._running
        if feedback is None or permission is None or permission.host != "controller":
            return tripped("host", "force feedback needs a permission for host controller")
        if wrench.fresh is None or wrench.header is None:
            return tripped(wrench.code or "invalid", wrench.fault)
        if (trip := self._guard.feedback(feedback)) is not None:
            return trip
        self._tracking.free()
        self._idle(now_ns)
        if running is None:
            self._start_feedback(feedback, now_ns)
        elif not self._dialogue.feedback_active:
            return tripped("feedback", "the controller has ended force feedback by itself")
        elif feedback.mode != running.feedback.mode:
            self._end_feedback(now_ns)
        else:
            if feedback.gains != running.feedback.gains:
                self._dialogue.offer_gains(feedback.gains)
            running.lever_m = self._move_centre(running, feedback)
            running.feedback = feedback
            sample = (wrench.header.epoch, wrench.header.seq)
            return self._feed_back(feedback, wrench.fresh, sample, now_ns - running.since_ns)
        return None

    def _start_feedback(self, feedback: Feedback, now_ns: int) -> None:
        if not self._may_begin:
            return
        self._send(self._dialogue.set_centre(self._centre(feedback), now_ns), now_ns)
        data = self._dialogue.start_feedback(
            feedback.mode, feedback.gains, permitted=True, now_ns=now_ns
        )
        self._send(data, now_ns)
        self._shaper.moved_otherwise()
        self._running = RunningFeedback(feedback, now_ns, feedback.lever_m)

    def _move_centre(self, running: RunningFeedback, feedback: Feedback) -> Vec3:
        """Offer the contact point as centre of rotation when it has moved; return the lever."""
        travel_m = dist(feedback.lever_m, running.lever_m)
        if travel_m < CENTRE_STEP_M:
            return running.lever_m
        self._dialogue.offer_centre(self._centre(feedback))
        return feedback.lever_m

    def _centre(self, feedback: Feedback) -> pin.SE3:
        """Return the centre of rotation as a frame in the flange's, with the TCP's axes."""
        T = self._T_flange_tcp
        return pin.SE3(T.rotation, T.translation + np.array(feedback.lever_m))

    def _end_feedback(self, now_ns: int) -> None:
        self._running = None
        self._send(self._dialogue.stop_feedback(now_ns), now_ns)

    def _feed_back(
        self, feedback: Feedback, wrench: WrenchAtTcp, sample: tuple[int, int], since_ns: int
    ) -> Trip | None:
        """Offer each sample once: the controller integrates every wrench it receives."""
        if not self._dialogue.feedback_reported:
            if since_ns > FEEDBACK_STARTS_WITHIN_S * NS_PER_S:
                return tripped("feedback", "the controller did not start force feedback")
        elif sample != self._last_wrench:
            self._last_wrench = sample
            self._dialogue.offer_wrench(
                wrench.force_N, wrench.torque_Nm, *slow_setpoint(feedback, wrench)
            )
        return None
