"""Driver of a Kawasaki controller: permitted commands to packets, reports to the state of the arm.

Packets that the dialogue has numbered are sent at once, also when a refusal follows: IDs have no
gaps.
"""

from collections.abc import Sequence

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of, record_of
from common.motion.unexplained import REACH, Reach, is_guided
from common.robot.driver import RobotDriver
from common.runtime.signal_service import SignalReading
from controller.packet_table import Com, Status
from forcemesh.clock import NS_PER_S
from forcemesh.errors import LocalProtocolError
from forcemesh.faults import tripped
from forcemesh.messages import (
    Goal,
    GoalState,
    PoseRecord,
    RobotCommand,
    Speed,
    Trip,
    WrenchAtTcp,
)
from services.gateway import goals
from services.gateway.connection import ControllerConnection
from services.gateway.feedback import ControllerFeedback
from services.gateway.goals import ControllerReport, Track
from services.gateway.setpoint_shaper import SetpointShaper


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
        self.feedback: ControllerFeedback = ControllerFeedback(
            self.dialogue, connection.send, shaper, cell.tool.T_flange_tcp.pose
        )
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
        return is_guided(self.connection.status.faults) or self.feedback.active

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
        self.feedback.held()
        self._shaper.end()
        if begins and self.dialogue.ready:
            self._send(self.dialogue.hold(self._now_ns))

    def flush(self, command: RobotCommand, wrench: WrenchAtTcp | None) -> None:
        """End stream and feedback that are not commanded; send set point, wrench or heartbeat."""
        if command.kind != "setpoint":
            self._shaper.end()
        if command.kind != "feedback":
            self.feedback.end(self._now_ns)
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

    # --- signals -----------------------------------------------------------------------

    def signals(self) -> SignalReading:
        """Return the state of the signals; unknown while the link has a fault."""
        return self.connection.signals(self._now_ns)

    def switch(self, number: int, on: bool) -> Trip | None:  # noqa: FBT001 - a `Switch`
        """Switch an output."""
        return self.connection.switch(number, on=on, now_ns=self._now_ns)
