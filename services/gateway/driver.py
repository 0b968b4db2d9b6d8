"""Driver of a Kawasaki controller: permitted commands to packets, reports to the state of the arm.

Packets that the dialogue has numbered are sent at once, also when a refusal follows: IDs have no
gaps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import dist

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of, record_of
from common.motion.frames import plus
from common.motion.limits import LEVER_M, share_at
from common.motion.unexplained import REACH, Reach, is_guided
from common.robot.driver import RobotDriver
from common.runtime.signal_service import SignalReading
from controller.packet_table import Com, Status
from forcemesh.clock import NS_PER_S
from forcemesh.errors import LocalProtocolError
from forcemesh.faults import tripped
from forcemesh.messages import (
    Feedback,
    Goal,
    GoalState,
    PoseRecord,
    RobotCommand,
    Speed,
    Trip,
    Vec3,
    WrenchAtTcp,
)
from services.gateway import goals
from services.gateway.connection import ControllerConnection
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


class ControllerDriver(RobotDriver):
    """A controller behind a connection."""

    def __init__(
        self,
        cell: CellConfig,
        connection: ControllerConnection,
        shaper: SetpointShaper,
        reach: Reach = REACH,
    ) -> None:
        """Start with nothing sent: every connection begins with hello and hold."""
        self.dialogue = connection.dialogue
        self.connection, self._shaper, self._reach = connection, shaper, reach
        self._T_flange_tcp: pin.SE3 = cell.tool.T_flange_tcp.pose
        self._running: RunningFeedback | None = None
        self._last_wrench: tuple[int, int] | None = None
        self._now_ns = 0
        self._is_new = False  # the report of this step
        # The largest speed at which the controller follows set points.
        self._stream_speed = Speed(mechanical_m_s=cell.limits.speed_m_s)
        self._stream_from = 0  # packet number of the first set point of a stream
        self._track = Track()  # of the last goal
        self._shows_wrench = cell.gateway is not None and cell.gateway.send_wrench
        self._show_period_ns = round(NS_PER_S / cell.rates.status_hz)
        self._shown_ns = 0

    def _send(self, data: bytes) -> None:
        self.connection.send(data, self._now_ns)

    # --- report -----------------------------------------------------------------------------------

    def receive(self, now_ns: int) -> None:
        """Serve the link."""
        connection, self._now_ns = self.connection, now_ns
        self._is_new = connection.poll(now_ns)
        fault = connection.link_fault(now_ns)
        self.link_fault = tripped(connection.code, fault) if fault else None
        self.arm_fault = connection.controller_fault()
        self.link, self.status = connection.link_health(), connection.status

    @property
    def measured(self) -> ControllerReport | None:
        """Last report of the controller."""
        return self.connection.measured

    def report(self) -> Sequence[ControllerReport]:
        """Return the last report, if it is new."""
        measured = self.connection.measured
        return [measured] if self._is_new and measured is not None else []

    @property
    def explains_motion(self) -> bool:
        """Whether a person may move the arm, or force feedback does."""
        return (
            is_guided(self.connection.status.faults)
            or self._running is not None
            or self.dialogue.feedback_active
        )

    # --- stream -----------------------------------------------------------------------------------

    def stream(self, T_base_flange: pin.SE3, *, begins: bool) -> Trip | None:
        """Offer a set point; the first one is sent at once, after the speed of the stream."""
        if not begins:
            if self._is_refused:
                return tripped("robot_refuses", "the controller refused a set point")
            self.dialogue.offer_setpoint(T_base_flange)
            return None
        if (trip := self._shaper.seed(T_base_flange, self._now_ns)) is not None:
            return trip
        self._send(self.dialogue.set_speed(self._stream_speed, self._now_ns))
        self.dialogue.offer_setpoint(T_base_flange)
        self._tick()
        self._stream_from = self.dialogue.window.last
        return None

    @property
    def _is_refused(self) -> bool:
        """Whether the controller has refused a set point of this stream."""
        measured = self.measured
        return (
            measured is not None
            and bool(measured.status & Status.TARGET_REFUSED)
            and measured.taken >= self._stream_from
        )

    def sent(self, setpoint: PoseRecord) -> PoseRecord | None:  # noqa: ARG002 - it may wait
        """Return the set point that was sent last."""
        return None if self._shaper.last is None else record_of(self._shaper.last)

    # --- goal -------------------------------------------------------------------------------------

    def may_begin(self, kind: str) -> bool:
        """Return whether a stream or a goal may begin; the end of a relative move needs a start."""
        measured = self.measured
        at_rest = self.dialogue.settled and measured is not None and not measured.moving
        return self.dialogue.may_begin and (kind != "by" or at_rest)

    def goal(self, goal: Goal, speed: Speed) -> str:
        """Send a goal."""
        measured = self.measured
        assert measured is not None  # noqa: S101 - nothing is permitted without
        self._send(self._goal_bytes(goal, speed))
        self._shaper.moved_otherwise()
        packet, start_rad = self.dialogue.window.last, measured.joint_rad
        self._track = goals.sent(goal, packet, start_rad, self._now_ns, reach=self._reach)
        return ""

    def _goal_bytes(self, goal: Goal, speed: Speed) -> bytes:
        if goal.kind == "pose" and goal.pose is not None:
            return self.dialogue.move_to_pose(pose_of(goal.pose), speed, self._now_ns)
        if goal.joint_rad is None:  # pragma: no cover - the guard has refused it before
            raise LocalProtocolError(f"a goal of kind {goal.kind} without its numbers")
        com = Com.MOVE_BY_JOINTS if goal.kind == "by" else Com.MOVE_JOINTS
        return self.dialogue.move_joints(com, goal.joint_rad, speed, self._now_ns)

    def goal_state(self) -> tuple[GoalState, str]:
        """Return the state of the goal by the reports."""
        measured = self.measured
        assert measured is not None  # noqa: S101 - a lost link ends the goal
        self._track = goals.follow(self._track, measured, self._now_ns)
        return self._track.state, self._track.reason

    # --- both -------------------------------------------------------------------------------------

    def hold(self, *, begins: bool) -> None:
        """Send command 8 once, which voids what waits; a new connection begins with it."""
        self._running = None
        self._shaper.end()
        if begins and self.dialogue.ready:
            self._send(self.dialogue.hold(self._now_ns))

    def flush(self, command: RobotCommand, wrench: WrenchAtTcp | None) -> None:
        """End stream and feedback that are not commanded; send set point, wrench or heartbeat."""
        if command.kind != "setpoint":
            self._shaper.end()
        if command.kind != "feedback":
            self._end_feedback()
            self._show(wrench)
        self._tick()

    def _show(self, wrench: WrenchAtTcp | None) -> None:
        """Offer the wrench for a display in the controller, at the rate of a status."""
        is_due = self._shows_wrench and self._now_ns - self._shown_ns >= self._show_period_ns
        if is_due and wrench is not None and not self.dialogue.feedback_active:
            self._shown_ns = self._now_ns
            self.dialogue.show_wrench(wrench.force_N, wrench.torque_Nm)

    def _tick(self) -> None:
        self._send(self.dialogue.tick(self._now_ns, permitted=True))

    # --- force feedback ---------------------------------------------------------------------------

    def feed_back(
        self, feedback: Feedback, wrench: WrenchAtTcp, sample: tuple[int, int]
    ) -> Trip | None:
        """Start, feed or change force feedback; return why it cannot run."""
        running = self._running
        if running is None:
            self._start_feedback(feedback)
        elif not self.dialogue.feedback_active:
            return tripped("feedback", "the controller has ended force feedback by itself")
        elif feedback.mode != running.feedback.mode:
            self._end_feedback()
        else:
            if feedback.gains != running.feedback.gains:
                self.dialogue.offer_gains(feedback.gains)
            running.lever_m = self._move_centre(running, feedback)
            running.feedback = feedback
            return self._offer_wrench(running, wrench, sample)
        return None

    def _start_feedback(self, feedback: Feedback) -> None:
        if not self.dialogue.may_begin:
            return
        now_ns = self._now_ns
        self._send(self.dialogue.set_centre(self._centre(feedback), now_ns))
        data = self.dialogue.start_feedback(
            feedback.mode, feedback.gains, permitted=True, now_ns=now_ns
        )
        self._send(data)
        self._shaper.moved_otherwise()
        self._running = RunningFeedback(feedback, now_ns, feedback.lever_m)

    def _end_feedback(self) -> None:
        """Stop feedback that was started."""
        if self._running is not None:
            self._running = None
            self._send(self.dialogue.stop_feedback(self._now_ns))

    def _move_centre(self, running: RunningFeedback, feedback: Feedback) -> Vec3:
        """Offer the contact point as centre of rotation when it has moved; return the lever."""
        travel_m = dist(feedback.lever_m, running.lever_m)
        if travel_m < CENTRE_STEP_M:
            return running.lever_m
        self.dialogue.offer_centre(self._centre(feedback))
        return feedback.lever_m

    def _centre(self, feedback: Feedback) -> pin.SE3:
        """Return the centre of rotation as a frame in the flange's, with the TCP's axes."""
        T = self._T_flange_tcp
        return pin.SE3(T.rotation, T.translation + np.array(feedback.lever_m))

    def _offer_wrench(
        self, running: RunningFeedback, wrench: WrenchAtTcp, sample: tuple[int, int]
    ) -> Trip | None:
        """Offer each sample once: the controller integrates every wrench it receives."""
        if not self.dialogue.feedback_reported:
            if self._now_ns - running.since_ns > FEEDBACK_STARTS_WITHIN_S * NS_PER_S:
                return tripped("feedback", "the controller did not start force feedback")
        elif sample != self._last_wrench:
            self._last_wrench = sample
            setpoint = slow_setpoint(running.feedback, wrench)
            self.dialogue.offer_wrench(wrench.force_N, wrench.torque_Nm, *setpoint)
        return None

    # --- signals ----------------------------------------------------------------------------------

    def signals(self) -> SignalReading:
        """Return the state of the signals; unknown while the link has a fault."""
        return self.connection.signals(self._now_ns)

    def switch(self, number: int, on: bool) -> Trip | None:  # noqa: FBT001 - a `Switch`
        """Switch an output."""
        return self.connection.switch(number, on=on, now_ns=self._now_ns)
