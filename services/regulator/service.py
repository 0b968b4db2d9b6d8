"""Regulator service: wrench and robot state in, proposed flange pose out."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from math import hypot
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of, record_of
from common.motion.joint_paths import tool_path_trips
from common.motion.joint_space import JointSpace
from control.adaptive import ContactStiffness
from control.axis_task import AxisTask
from control.compliance import ComplianceState
from control.delay_monitor import (
    DelayMonitor,
)
from control.gain_rule import instability, tune
from control.gains import merged_gains
from control.law import start_at
from control.laws import LAWS, refuse_unknown_law
from control.monitors import (
    MonitorState,
    unchecked_axes,
)
from control.timing import LoopTiming, SampleTime, TimingSettings
from forcemesh import topics
from forcemesh.bus import Bus, Incoming, Reading
from forcemesh.clock import NS_PER_S
from forcemesh.faults import refused, tripped
from forcemesh.messages import (
    OPERATIONAL,
    ContactEvent,
    RegulatorTarget,
    RobotState,
    Trip,
    WrenchAtTcp,
)
from forcemesh.requests import ForceStartRequest, GainsRequest, PathRequest, Reply
from services.regulator import period
from services.regulator.contact_events import ContactTracker
from services.regulator.path_request import next_path, path_poses, turn_limits
from services.regulator.period import PeriodSettings, Sensed
from services.regulator.refusals import (
    refused_axes,
    refused_gains,
    refused_owner,
    refused_path,
    refused_start,
)
from services.regulator.session import (
    ForceOwner,
    ForceSession,
    active_commander,
    change_task,
    describe,
    valid_target,
)
from services.regulator.task_refusals import refused_task
from services.regulator.task_request import first_setpoint, request_task, task_mode

OwnedRequest = TypeVar("OwnedRequest", ForceStartRequest, GainsRequest, PathRequest)

STOPPED = "stopped"
STOPPED_REPLY = Reply(accepted=True, text="force feedback is off; the arm stays where it is")
NOT_RUNNING = tripped("not_armed", "no force feedback is running: start it first")
CHECKED_S = 0.0005  # of a period, for each sample of the check of a path


class Regulator:
    """Service that publishes proposed poses while force feedback runs, otherwise valid=False."""

    def __init__(
        self,
        bus: Bus,
        cell: CellConfig,
        *,
        stop_reason: str = STOPPED,
        contact: ContactEvent | None = None,
    ) -> None:
        """Open the topics of this role and tune the gains for this cell.

        Args:
            bus: Bus of the cell.
            cell: The cell.
            stop_reason: Published until force feedback starts; in a replay that of before.
            contact: In a replay the contact of before.
        """
        self.period_s = 1.0 / cell.rates.control_hz
        self.fault = ""
        self._cell = cell
        self._timing = TimingSettings.of(cell)
        refuse_unknown_law(cell, f"cell {cell.cell}")
        self._settings = PeriodSettings.of(cell)
        self._last_delay: DelayMonitor | None = None  # of the last session
        self._contact: ContactStiffness | None = None  # identified by the last session
        self._gains = tune(cell).gains
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self._T_tcp_flange = self._T_flange_tcp.inverse()
        self._space = JointSpace.of(cell)
        self._session: ForceSession | None = None
        self._stop_reason = stop_reason
        self._now_ns = 0
        self._put_ns = 0, 0  # of the last two targets
        self._wrench = bus.reader(topics.WRENCH)
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._command = bus.reader(topics.ROBOT_COMMAND)
        self._arbiter = bus.reader(topics.ARBITER_STATUS)
        self._target = bus.publisher(topics.REGULATOR_TARGET)
        self._tracker = ContactTracker(cell, contact)
        self._contacts = bus.publisher(topics.CONTACT)
        self._starts = bus.inbox(topics.FORCE_START)
        self._stops = bus.inbox(topics.FORCE_STOP)
        self._gain_requests = bus.inbox(topics.GAINS)
        self._paths = bus.inbox(topics.FORCE_PATH)
        self._path_work = self._follow_paths()
        self._path_parts = max(1, round(self.period_s / CHECKED_S))  # of each step
        self.trigger = self._wrench

    def counters(self) -> dict[str, int]:
        """Return the number of wrenches superseded before they were read."""
        return {"wrench_superseded": self._wrench.counters.superseded}

    def numbers(self, _now_ns: int) -> dict[str, float]:
        """Return delay and gain share of the running session, or of the last one."""
        delay = self._last_delay if self._session is None else self._session.delay
        return {} if delay is None else delay.numbers(self._settings.delay)

    def step(self, now_ns: int) -> None:
        """Serve requests, integrate the newest wrench, publish the target."""
        self._now_ns = now_ns
        wrench, robot = self._wrench.read(now_ns), self._robot.read(now_ns)
        self._serve(wrench, robot)
        if self._session is not None:  # it ends when the arbiter holds, and does not resume
            status = self._arbiter.read(now_ns)
            if (arbiter := status.fresh) is None:
                self._end(status.fault)
            elif arbiter.state not in OPERATIONAL:
                self._end(f"the arbiter is {arbiter.state}")
            elif arbiter.lease != self._session.lease:  # held and armed again between two readings
                self._end("the arm was armed again")
            elif commander := active_commander(arbiter):
                self._end(f"the {commander} commands the arm")
        self._publish(wrench, robot)

    def _serve(self, wrench: Reading[WrenchAtTcp], robot: Reading[RobotState]) -> None:
        for start in self._starts.take_all():
            start.reply(self._owned(start, partial(self._start, wrench=wrench, robot=robot)))
        for stop in self._stops.take_all():
            self._end(STOPPED)
            stop.reply(STOPPED_REPLY)
        for change in self._gain_requests.take_all():
            reply = self._owned(change, self._change_gains, is_free=not change.request.changes)
            change.reply(reply.replaced(gains=self._gains))
        for _ in range(self._path_parts):
            if not next(self._path_work):
                break

    def _publish(self, wrench: Reading[WrenchAtTcp], robot: Reading[RobotState]) -> None:
        self._target.put(self._propose(wrench, robot), wrench.origin)
        self._put_ns = self._put_ns[1], self._now_ns
        event = self._tracker.next(wrench, robot, self._session)
        if event is not None:  # after the target, by which a replay separates the steps
            self._contacts.put(event, wrench.origin)

    def _propose(self, wrench: Reading[WrenchAtTcp], robot: Reading[RobotState]) -> RegulatorTarget:
        session, fresh, arm = self._session, wrench.fresh, robot.fresh
        if session is None:
            contact = self._contact
            if fresh is None or (contact and hypot(*fresh.force_N) <= contact.touch_N):
                self._contact = None
            return RegulatorTarget(valid=False, reason=self._stop_reason)
        if session.failed is not None:
            return session.failed
        if fresh is None or arm is None or wrench.header is None:
            worse: Reading[Any] = wrench if wrench.fault else robot
            return self._fail(session, worse.code, worse.fault)
        T_measured = pose_of(arm) * self._T_flange_tcp
        if session.request.host == "controller":  # it moves the arm: the set point follows the tool
            session.motion.T_base_tcp = T_measured
        # Integrate once per sample, over the time between the samples' stamps.
        time = session.timing.sample(
            wrench.header.stamp_ns, wrench.origin, robot.header, robot.age_s
        )
        if time is not None:
            sensed = self._sense(session, fresh, arm, T_measured=T_measured, time=time)
            trip = period.step(session, sensed, self._gains, self._settings)
            if trip is not None:
                return self._fail(session, trip.code, trip.text)
        self.fault = ""
        tau_s = self._settings.delay.tau_s
        return valid_target(session, self._gains, self._T_tcp_flange, tau_s)

    def _fail(self, session: ForceSession, code: str, text: str) -> RegulatorTarget:
        """Latch the failure; the mode stays in the message, so the arbiter stops the motion."""
        mode, host = session.mode, session.request.host
        failed = RegulatorTarget(valid=False, reason=text, code=code, mode=mode, host=host)
        session.failed, self.fault = failed, text
        return failed

    def _sense(
        self,
        session: ForceSession,
        wrench: WrenchAtTcp,
        robot: RobotState,
        *,
        T_measured: pin.SE3,
        time: SampleTime,
    ) -> Sensed:
        """Return the inputs of a period, with the command that the arbiter has released last."""
        released = self._command.read(self._now_ns)
        command = released.fresh
        if command is not None and session.request.host == "pc":  # also before its first set point
            unanswered_s = (self._now_ns - self._put_ns[0]) / NS_PER_S
            is_late = time.is_late or released.age_s > unanswered_s  # two without an answer
            time = time._replace(is_late=is_late)
        if command is None or command.pose is None:
            proposed = record_of(session.motion.T_base_tcp * self._T_tcp_flange)
            return Sensed(wrench, robot, T_measured, time, proposed, is_limited=False)
        return Sensed(wrench, robot, T_measured, time, command.pose, command.limited)

    def _owned(
        self, incoming: Incoming[OwnedRequest], execute: Callable[[OwnedRequest], Reply],
        *, is_free: bool = False,
    ) -> Reply:  # fmt: skip
        """Execute a request of the owner of force control, or of a higher rank, which takes it.

        A free one, such as a question, changes nothing: every client may send it.
        """
        if is_free:
            return execute(incoming.request)
        asker = _asker(incoming)
        if (trip := refused_owner(self._session, asker)) is not None:
            return refused(trip)
        reply = execute(incoming.request)
        if reply.accepted and self._session is not None:
            self._session.owner = asker
        return reply

    def _change_gains(self, request: GainsRequest) -> Reply:
        gains = merged_gains(self._gains, request, self._cell)
        if (trip := refused_gains(request, gains, self._cell)) is not None:
            return refused(trip)
        self._gains = gains
        return Reply(accepted=True, text=instability(self._cell, gains))

    def _end(self, reason: str) -> None:
        if (session := self._session) is not None:
            settings = self._settings.laws[session.law].of_law
            self._contact = LAWS[session.law].identified(session.state, settings)
            self._last_delay = session.delay
        self._session, self._stop_reason, self.fault = None, reason, ""

    def _start(
        self,
        request: ForceStartRequest,
        wrench: Reading[WrenchAtTcp],
        robot: Reading[RobotState],
    ) -> Reply:
        cell, fresh, arbiter = self._cell, wrench.fresh, self._arbiter.read(self._now_ns).fresh
        worse: Reading[Any] = wrench if wrench.fault else robot
        trip = refused_start(request, cell, arbiter, worse)
        if trip is not None or robot.fresh is None or fresh is None or arbiter is None:
            return refused(trip or tripped(worse.code, worse.fault))
        T_measured = pose_of(robot.fresh) * self._T_flange_tcp
        requested = request.law or cell.force.law
        goal = request_task(request, T_measured, cell, mounting_rad=fresh.mounting_rotation_rad)
        trip = (
            unchecked_axes(fresh, torques=task_mode(goal) != "position")
            or refused_task(request, cell, goal.R_base_task(T_measured.rotation.tolist()))
            or refused_axes(request, T_measured.rotation)
        )
        if trip is not None:
            return refused(trip)
        if request.preset is not None:
            self._gains = tune(cell, request.preset).gains
        law = requested if LAWS[requested].covers(cell) else "plain"
        first = first_setpoint(goal, fresh.force_N, fresh.torque_Nm, T_measured)
        session = self._session
        if session is None or session.failed or session.request.host != request.host:
            session = ForceSession(
                request,
                law,
                arbiter.lease,
                goal,
                first,
                self._gains,
                start_at(T_measured),
                self._begin(law, goal, T_measured, T_measured),
                monitored=MonitorState(),
                compliance=ComplianceState.at(goal, T_measured, T_measured),
                timing=LoopTiming(
                    self._timing, wrench.header.stamp_ns if wrench.header else self._now_ns
                ),
            )
        else:
            is_same = change_task(session, request, goal, first)
            T_command = session.motion.T_base_tcp
            if not (is_same and session.compliance.covers(goal)):
                session.compliance = ComplianceState.at(goal, T_command, T_measured)
            if law != session.law or not is_same:
                session.motion.follows = False
                session.state = self._begin(law, goal, T_command, T_measured)
                session.law = law
        self._session, remark = session, LAWS[requested].remark(cell)
        text = describe(session)
        return Reply(accepted=True, text=f"{text}; {remark}" if remark else text)

    def _begin(self, law: str, task: AxisTask, T_command: pin.SE3, T_measured: pin.SE3) -> Any:
        """Return the initial state of a law, with the stiffness identified here before."""
        R_base_task = np.array(task.R_base_task(T_measured.rotation.tolist()))
        T_task = pin.SE3(R_base_task, T_measured.translation)
        k = None if self._contact is None else self._contact.at_pose(T_task)
        return LAWS[law].begin(T_command, T_measured, k, self._settings.laws[law].of_law)

    def _follow_paths(self) -> Iterator[bool]:
        """Serve one path request after the other, in parts; yield whether one is in work."""
        while True:
            if (path := next(self._paths.take_all(), None)) is None:
                yield False
                continue
            trip = refused_owner(self._session, _asker(path))
            for found in self._path_trips(path.request) if trip is None else ():
                if (trip := found) is not None:
                    break
                yield True
            path.reply(self._owned(path, self._follow_path) if trip is None else refused(trip))
            yield True

    def _path_trips(self, request: PathRequest) -> Iterator[Trip | None]:
        """Check a path: the request as a whole, then sample by sample whether the joints follow."""
        if (session := self._session) is None or session.failed is not None:
            return iter((NOT_RUNNING,))
        T_from = session.path_end(append=request.append)
        poses = path_poses(request, T_from)
        joints = tool_path_trips(
            self._space, poses, self._robot.read(self._now_ns).fresh, T_from,
            T_tcp_flange=self._T_tcp_flange, speed_m_s=request.speed_m_s,
        )  # fmt: skip
        return chain((refused_path(request, session, poses, self._cell),), joints)

    def _follow_path(self, request: PathRequest) -> Reply:
        if (session := self._session) is None or session.failed is not None:
            return refused(NOT_RUNNING)
        poses = path_poses(request, session.path_end(append=request.append))
        if (trip := refused_path(request, session, poses, self._cell)) is not None:
            return refused(trip)
        session.path = next_path(
            session.path, request, poses, T_base_tcp=session.motion.T_base_tcp, task=session.goal,
            turns_frame=session.follows_tangent, predicts=LAWS[session.law].predicts,
            turns=turn_limits(self._cell),
        )  # fmt: skip
        what = f"{len(poses)} poses" if request.poses else f"{len(poses)} points"
        return Reply(accepted=True, text=f"the tool follows {what}")


def _asker(incoming: Incoming[OwnedRequest]) -> ForceOwner:
    return ForceOwner(incoming.request.commander, incoming.envelope.client)
