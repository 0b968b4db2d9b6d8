"""The regulator on the bus: wrench and robot state in, proposed flange pose out."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from common import topics
from common.cell import Cell
from common.clock import NS_PER_S
from common.convert import pose_of, record_of, vec3
from common.endpoints import Bus, Reading
from common.faults import refusal
from common.messages import Feedback, RegulatorTarget, RobotState, Trip, WrenchAtTcp
from common.requests import ForceStartRequest, PathRequest, Reply
from services.regulator import adaptive, guiding
from services.regulator.adaptive import Adaptive
from services.regulator.control import (
    LawTools,
    Met,
    control,
    controller_gains,
    kept,
    masked,
    met,
    ramped,
)
from services.regulator.guards import GuardSettings, Watch, watch
from services.regulator.guiding import GuideSettings
from services.regulator.law import LawInput, LawState, put_back, start_at
from services.regulator.refusals import refused_path, refused_start
from services.regulator.session import (
    Failure,
    Session,
    along,
    failure_of,
    first_setpoint_N,
    in_words,
    mover,
    next_route,
    seen_by,
    way_left,
)
from services.regulator.settings import merged_gains, pi_gains
from services.regulator.tuning import instability, tune

STOPPED = "stopped"
LONGEST_GAP_PERIODS = 3.0  # a longer gap between samples is not integrated over


class Regulator:
    """Proposes poses while force feedback runs, and says "not valid" while it does not."""

    def __init__(self, bus: Bus, cell: Cell) -> None:
        """Take the topics of this role and tune the gains for this cell."""
        self.period_s = 1.0 / cell.rates.control_hz
        self.fault = ""
        self._cell = cell
        self._tools, self._guards = LawTools.of(cell), GuardSettings.of(cell)
        self._guide = GuideSettings.of(cell)
        self._met: Met | None = None
        self._gains = tune(cell).gains
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self._session: Session | None = None
        self._stop_reason = STOPPED
        self._now_ns = 0
        self._wrench = bus.reader(topics.WRENCH)
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._command = bus.reader(topics.ROBOT_COMMAND)
        self._arbiter = bus.reader(topics.ARBITER_STATUS)
        self._target = bus.publisher(topics.REGULATOR_TARGET)
        self._starts = bus.inbox(topics.FORCE_START)
        self._stops = bus.inbox(topics.FORCE_STOP)
        self._gain_requests = bus.inbox(topics.GAINS)
        self._paths = bus.inbox(topics.FORCE_PATH)
        self.trigger = self._wrench

    def counters(self) -> dict[str, int]:
        """Return what the wrench reader dropped."""
        return {"wrench_superseded": self._wrench.counters.superseded}

    def step(self, now_ns: int) -> None:
        """Serve requests, integrate the newest wrench, publish the target."""
        self._now_ns = now_ns
        wrench, robot = self._wrench.read(now_ns), self._robot.read(now_ns)
        self._serve(now_ns, wrench, robot)
        self._stop_unless_allowed(now_ns)
        self._target.put(self._propose(wrench, robot), wrench.origin)

    def _propose(self, wrench: Reading[WrenchAtTcp], robot: Reading[RobotState]) -> RegulatorTarget:
        session = self._session
        if session is None:
            self._met = kept(self._met, wrench.fresh, self._tools)
            return RegulatorTarget(valid=False, reason=self._stop_reason)
        wanted = session.wanted
        failure = session.failure or failure_of(wrench) or failure_of(robot)
        if failure is not None or wrench.fresh is None or robot.fresh is None:
            return self._give_up(session, failure or Failure("invalid", "no wrench, no pose"))
        on_controller = wanted.host == "controller"
        T_base_tcp = pose_of(robot.fresh) * self._T_flange_tcp
        if on_controller:  # it moves the arm by itself: the set point goes with the measured tool
            session = replace(session, law=replace(session.law, T_base_tcp=T_base_tcp))
        session, trip = self._advance(session, wrench, wrench.fresh, T_base_tcp, robot=robot)
        if trip is not None:
            return self._give_up(session, Failure(trip.code, trip.text))
        self._session, self.fault = session, ""
        law = session.law
        T_base_flange = law.T_base_tcp * self._T_flange_tcp.inverse()
        return RegulatorTarget(
            mode=wanted.mode,
            host=wanted.host,
            pose=None if on_controller else record_of(T_base_flange),
            feedback=self._feedback(session) if on_controller else None,
            contact=law.contact,
            error_force_N=vec3(np.zeros(3) if law.error_force_N is None else law.error_force_N),
            error_torque_Nm=vec3(
                np.zeros(3) if law.error_torque_Nm is None else law.error_torque_Nm
            ),
            path_left_m=way_left(session),
        )

    def _give_up(self, session: Session, failure: Failure) -> RegulatorTarget:
        """Latch: the mode stays in the message, it runs and cannot go on, so the arbiter stops."""
        self._session, self.fault = replace(session, failure=failure), failure.text
        wanted, (code, text) = session.wanted, failure
        return RegulatorTarget(
            valid=False, reason=text, code=code, mode=wanted.mode, host=wanted.host
        )

    def _advance(
        self,
        session: Session,
        reading: Reading[WrenchAtTcp],
        wrench: WrenchAtTcp,
        T_base_tcp: pin.SE3,
        *,
        robot: Reading[RobotState],
    ) -> tuple[Session, Trip | None]:
        """Integrate once per sample, over the time that really passed between samples."""
        stamp_ns = reading.header.stamp_ns if reading.header else session.last_sample_ns
        gap_s = (stamp_ns - session.last_sample_ns) / NS_PER_S
        if gap_s <= 0.0:
            return session, None
        dt_s = min(gap_s, LONGEST_GAP_PERIODS * self.period_s)
        report = (robot.header.epoch, robot.header.seq) if robot.header else None
        setpoint_N = self._ramp(session.setpoint_N, session.wanted.setpoint_N, dt_s)
        sample = LawInput(
            force_N=np.array(wrench.force_N),
            torque_Nm=np.array(wrench.torque_Nm),
            setpoint_N=setpoint_N,
            mode=session.wanted.mode,
            dt_s=dt_s,
            pose_is_new=report != session.report,
        )
        before = self._follow_limits(session.law)
        sample = masked(sample, session.wanted, before.T_base_tcp.rotation)
        gains = ramped(session.gains, self._gains, dt_s)
        law, memory, guide = before, session.memory, session.guide
        if guide is None:
            law, memory = control(
                before, memory, sample, T_base_tcp, gains=pi_gains(gains), tools=self._tools
            )
        else:
            law, guide = guiding.advance(
                before,
                guide,
                sample,
                T_base_tcp,
                gains=pi_gains(gains),
                plain=self._tools.plain,
                settings=self._guide,
            )
        most_m_s = self._cell.force.speed_max_m_s
        law, way = along(before, law, session.route, dt_s=dt_s, speed_max_m_s=most_m_s)
        sent = None
        if memory is not None and session.wanted.host == "controller":
            sent = controller_gains(
                session.sent,
                self._gains,
                law.T_base_tcp.rotation,
                memory=memory,
                tools=self._tools,
            )
        watched, trip = watch(session.watch, seen_by(law, sample, T_base_tcp, memory), self._guards)
        session = replace(session, law=law, memory=memory, guide=guide, setpoint_N=setpoint_N)
        session = replace(session, gains=gains, sent=sent, watch=watched, route=way)
        return replace(session, last_sample_ns=stamp_ns, report=report), trip

    def _follow_limits(self, law: LawState) -> LawState:
        """Back-calculate: where a limit was in the way, go on from what was let through."""
        command = self._command.read(self._now_ns).fresh
        if command is None or not command.limited or command.pose is None:
            return law
        return put_back(law, pose_of(command.pose) * self._T_flange_tcp)

    def _ramp(self, now_N: float, wanted_N: float, dt_s: float) -> float:
        step_N = self._cell.force.setpoint_ramp_N_s * dt_s
        return min(max(wanted_N, now_N - step_N), now_N + step_N)

    def _feedback(self, session: Session) -> Feedback:
        law = session.law
        R_base_flange = (law.T_base_tcp * self._T_flange_tcp.inverse()).rotation
        lever_m = np.zeros(3) if law.lever_m is None else R_base_flange.T @ law.lever_m
        return Feedback(
            mode=session.wanted.mode,
            setpoint_force_N=vec3(-session.setpoint_N * law.T_base_tcp.rotation[:, 2]),
            lever_m=vec3(lever_m),
            gains=session.sent or self._gains,
        )

    def _stop_unless_allowed(self, now_ns: int) -> None:
        """End the session when the arbiter holds: nothing goes on by itself after a hold."""
        if self._session is None:
            return
        status = self._arbiter.read(now_ns)
        arbiter = status.fresh
        if arbiter is None:
            self._end(status.fault)
        elif not arbiter.goes_on:
            self._end(f"the arbiter is {arbiter.state}")
        elif arbiter.lease != self._session.lease:  # held and armed again between two readings
            self._end("the arm was armed anew")
        elif who := mover(arbiter):
            self._end(f"the {who} commands the arm")

    def _end(self, reason: str) -> None:
        self._met = met(self._session.memory) if self._session else self._met
        self._session, self._stop_reason, self.fault = None, reason, ""

    def _serve(self, now_ns: int, wrench: Reading[WrenchAtTcp], robot: Reading[RobotState]) -> None:
        for start in self._starts.take_all():
            start.reply(self._start(start.request, now_ns, wrench, robot))
        for stop in self._stops.take_all():
            self._end(STOPPED)
            stop.reply(Reply(accepted=True, text="force feedback is stopped; the arm stays"))
        for change in self._gain_requests.take_all():
            self._gains = merged_gains(self._gains, change.request, self._cell)
            text = instability(self._cell, self._gains)
            change.reply(Reply(accepted=True, text=text, gains=self._gains))
        for path in self._paths.take_all():
            path.reply(self._follow_path(path.request))

    def _start(
        self,
        wanted: ForceStartRequest,
        now_ns: int,
        wrench: Reading[WrenchAtTcp],
        robot: Reading[RobotState],
    ) -> Reply:
        arbiter = self._arbiter.read(now_ns).fresh
        worse: Reading[Any] = wrench if wrench.fault else robot
        refused = refused_start(wanted, self._cell, arbiter, worse)
        if refused is not None or robot.fresh is None or wrench.fresh is None or arbiter is None:
            return refused or refusal(worse.code, worse.fault)
        if wanted.preset is not None:
            self._gains = tune(self._cell, wanted.preset).gains
        T_measured = pose_of(robot.fresh) * self._T_flange_tcp
        guide = guiding.begin(T_measured) if wanted.law == "guide" else None
        running = self._session
        if running is not None and running.wanted.host == wanted.host and not running.failure:
            memory = self._memory(wanted, running.law.T_base_tcp, robot.fresh, running.memory)
            running = replace(running, wanted=wanted, watch=Watch(), memory=memory)
            guide = guide and (running.guide or guide)
            self._session = replace(running, guide=guide, route=None)
            return Reply(accepted=True, text=in_words(wanted, wanted.law or self._cell.force.law))
        law = start_at(T_measured)
        stamp_ns = wrench.header.stamp_ns if wrench.header else now_ns
        memory = self._memory(wanted, law.T_base_tcp, robot.fresh, None)
        setpoint_N = first_setpoint_N(np.array(wrench.fresh.force_N), T_measured, wanted.setpoint_N)
        self._session = Session(
            wanted, setpoint_N, law, stamp_ns, arbiter.lease, Watch(), self._gains, memory, guide
        )
        return Reply(accepted=True, text=in_words(wanted, wanted.law or self._cell.force.law))

    def _follow_path(self, wanted: PathRequest) -> Reply:
        session = self._session
        refused = refused_path(wanted, session, self._cell)
        if refused is not None or session is None:
            return refused or refusal("not_armed", "no force feedback is running")
        self._session = replace(session, route=next_route(session, wanted))
        return Reply(accepted=True, text=f"{len(wanted.points_m)} points")

    def _memory(
        self,
        wanted: ForceStartRequest,
        T_command: pin.SE3,
        robot: RobotState,
        running: Adaptive | None,
    ) -> Adaptive | None:
        """Return what the adaptive law begins with, None for the plain law."""
        if (wanted.law or self._cell.force.law) != "adaptive":
            return None
        if running is not None:
            return running
        T_measured = pose_of(robot) * self._T_flange_tcp
        k = None if self._met is None else self._met.still(T_measured)
        return adaptive.begin(T_command, T_measured, self._tools.adaptive, k)
