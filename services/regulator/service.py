"""Regulator service: wrench and robot state in, proposed flange pose out."""

from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of, record_of, vec3
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.bus import Bus, Reading
from forcemesh.clock import NS_PER_S
from forcemesh.faults import refusal
from forcemesh.messages import (
    ZERO3,
    Feedback,
    Gains,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    StartLaw,
    Trip,
    WrenchAtTcp,
)
from forcemesh.requests import ForceStartRequest, PathRequest, Reply
from services.regulator import adaptive, admittance
from services.regulator.adaptive import AdaptiveState
from services.regulator.admittance import AdmittanceSettings, AdmittanceState
from services.regulator.control import (
    ContactStiffness,
    LawTools,
    control,
    controller_gains,
    last_identified,
    ramped,
    reset_predictor,
    still_valid,
    task_frame,
)
from services.regulator.guards import (
    GuardSettings,
    GuardState,
    kept_over_restart,
    verifies_press_axis,
    watch,
)
from services.regulator.law import LawInput, LawState, back_calculate, start_at
from services.regulator.link_lag import CommandHistory
from services.regulator.refusals import (
    refused_axes,
    refused_guide,
    refused_path,
    refused_start,
)
from services.regulator.session import (
    Failure,
    ForceSession,
    active_commander,
    apply_path,
    describe,
    failure_of,
    first_setpoint_N,
    guard_sample,
    next_path,
    remaining_path_m,
)
from services.regulator.settings import merged_gains, pi_gains
from services.regulator.unverified_axes import (
    AxisVerification,
    ToolMotion,
    YieldTravel,
    checked_by,
    motion_between,
    origin,
)
from tuning.adaptive_map import restriction, softest_N_m
from tuning.gain_rule import instability, tune

STOPPED = "stopped"
LONGEST_GAP_PERIODS = 3.0  # longest time between samples that is integrated


class Regulator:
    """Service that publishes proposed poses while force feedback runs, otherwise valid=False."""

    def __init__(self, bus: Bus, cell: CellConfig) -> None:
        """Open the topics of this role and tune the gains for this cell."""
        self.period_s = 1.0 / cell.rates.control_hz
        self.fault = ""
        self._cell = cell
        self._tools, self._guards = LawTools.of(cell), GuardSettings.of(cell)
        self._guide = AdmittanceSettings.of(cell)
        self._contact_stiffness: ContactStiffness | None = None
        self._verification = AxisVerification()
        self._yielded: tuple[int, YieldTravel] | None = (
            None  # lease, and travel of its last session
        )
        self._gains = tune(cell).gains
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self._T_tcp_flange = self._T_flange_tcp.inverse()
        self._session: ForceSession | None = None
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
        """Return the number of wrenches superseded before they were read."""
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
        if wrench.fresh is not None:
            self._verification = checked_by(self._verification, wrench.fresh)
        if session is None:
            self._contact_stiffness = still_valid(
                self._contact_stiffness, wrench.fresh, self._tools
            )
            return RegulatorTarget(valid=False, reason=self._stop_reason)
        request = session.request
        failure = session.failure or failure_of(wrench) or failure_of(robot)
        if failure is not None or wrench.fresh is None or robot.fresh is None:
            return self._fail(session, failure or Failure("invalid", "no wrench, no pose"))
        on_controller = request.host == "controller"
        T_base_tcp = pose_of(robot.fresh) * self._T_flange_tcp
        if on_controller:  # it moves the arm itself: the set point follows the measured tool
            session = replace(session, law=replace(session.law, T_base_tcp=T_base_tcp))
        session, trip = self._advance(session, wrench, wrench.fresh, T_base_tcp, robot=robot)
        if trip is not None:
            return self._fail(session, Failure(trip.code, trip.text))
        self._session, self.fault = session, ""
        law = session.law
        T_base_flange = law.T_base_tcp * self._T_tcp_flange
        return RegulatorTarget(
            mode=request.mode,
            host=request.host,
            law=self._law_of(request),
            setpoint_N=request.setpoint_N,
            pose=None if on_controller else record_of(T_base_flange),
            feedback=self._feedback(session) if on_controller else None,
            contact=law.contact,
            error_force_N=ZERO3 if law.error_force_N is None else vec3(law.error_force_N),
            error_torque_Nm=ZERO3 if law.error_torque_Nm is None else vec3(law.error_torque_Nm),
            path_left_m=remaining_path_m(session),
        )

    def _fail(self, session: ForceSession, failure: Failure) -> RegulatorTarget:
        """Latch the failure; the mode stays in the message, so the arbiter stops the motion."""
        self._session, self.fault = replace(session, failure=failure), failure.text
        request, (code, text) = session.request, failure
        return RegulatorTarget(
            valid=False, reason=text, code=code, mode=request.mode, host=request.host
        )

    def _advance(
        self,
        session: ForceSession,
        reading: Reading[WrenchAtTcp],
        wrench: WrenchAtTcp,
        T_base_tcp: pin.SE3,
        *,
        robot: Reading[RobotState],
    ) -> tuple[ForceSession, Trip | None]:
        """Integrate once per sample, over the time that passed between the samples' stamps."""
        stamp_ns = reading.header.stamp_ns if reading.header else session.last_sample_ns
        gap_s = (stamp_ns - session.last_sample_ns) / NS_PER_S
        if gap_s <= 0.0:
            return session, None
        dt_s = min(gap_s, LONGEST_GAP_PERIODS * self.period_s)
        report = (robot.header.epoch, robot.header.seq) if robot.header else None
        target_N = min(session.request.setpoint_N, self._approach_N(session))
        setpoint_N = self._ramp(session.setpoint_N, target_N, dt_s)
        command = self._command.read(self._now_ns).fresh
        T_limited = self._limited_pose(command)
        before = session.law
        if command is not None and command.limited and T_limited is not None:
            before = back_calculate(before, T_limited)  # back-calculation anti-windup
        sample = LawInput(
            force_N=np.array(wrench.force_N), torque_Nm=np.array(wrench.torque_Nm),
            setpoint_N=setpoint_N, mode=session.request.mode, dt_s=dt_s,
            pose_is_new=report != session.report,
            R_base_task=task_frame(session.request, before.T_base_tcp.rotation),
            axes=session.request.axes,
        )  # fmt: skip
        gains = ramped(session.gains, self._gains, dt_s)
        commanded = session.commanded or CommandHistory.of(self._cell)
        T_commanded = before.T_base_tcp if T_limited is None else T_limited
        commanded = commanded.after(T_commanded, dt_s)
        law, adaptive_state, guide, path = before, session.adaptive, session.guide, session.path
        if commanded.lag(self._sent(robot.fresh)):
            law, adaptive_state, commanded = self._restart_after_lag(
                session, before, commanded, T_base_tcp
            )
        else:
            law, adaptive_state, guide = self._law(session, before, sample, T_base_tcp, gains=gains)
        motion = self._motion(session, law, T_base_tcp)
        if law.T_base_tcp is not before.T_base_tcp:
            most_m_s = self._cell.force.speed_max_m_s
            law, path = apply_path(before, law, path, dt_s=dt_s, speed_max_m_s=most_m_s)
        sent = self._for_controller(session, adaptive_state, law.T_base_tcp.rotation)
        rotates = session.request.mode != "position"
        limited = self._verification.limited(wrench.calibration, rotates=rotates)
        guarded = guard_sample(
            law, sample, T_base_tcp, adaptive_state, motion=motion, limited=limited
        )
        watched, trip = watch(session.watch, guarded, self._guards)
        if trip is None and verifies_press_axis(watched, guarded, self._guards):
            self._verification = replace(self._verification, touched=origin(wrench.calibration))
        session = replace(
            session, law=law, adaptive=adaptive_state, guide=guide, setpoint_N=setpoint_N,
            gains=gains, sent=sent, watch=watched, path=path, T_measured=T_base_tcp,
            commanded=commanded, last_sample_ns=stamp_ns, report=report,
        )  # fmt: skip
        return session, trip

    def _for_controller(
        self, session: ForceSession, adaptive_state: AdaptiveState | None, R_base_tcp: Array
    ) -> Gains | None:
        """Return the adaptive law's gains for the controller, None when the PC is the host."""
        if adaptive_state is None or session.request.host != "controller":
            return None
        return controller_gains(
            session.sent, self._gains, R_base_tcp, adaptive_state=adaptive_state, tools=self._tools
        )

    def _restart_after_lag(
        self,
        session: ForceSession,
        before: LawState,
        commanded: CommandHistory,
        T_measured: pin.SE3,
    ) -> tuple[LawState, AdaptiveState | None, CommandHistory]:
        """Return states at rest behind a stalled link; without a path, at the oldest command."""
        if session.path is not None:  # the pending commands contain path motion
            return back_calculate(before, before.T_base_tcp), session.adaptive, commanded
        law = back_calculate(before, commanded.oldest)
        adaptive_state = reset_predictor(session.adaptive, law, T_measured, self._tools)
        return law, adaptive_state, commanded.restarted()

    def _law(
        self,
        session: ForceSession,
        before: LawState,
        sample: LawInput,
        T_measured: pin.SE3,
        *,
        gains: Gains,
    ) -> tuple[LawState, AdaptiveState | None, AdmittanceState | None]:
        """Return the next states of the active law."""
        plain, pi = self._tools.plain, pi_gains(gains)
        if (guide := session.guide) is not None:
            law, guide = admittance.advance(
                before, guide, sample, T_measured, gains=pi, plain=plain, settings=self._guide
            )
            return law, session.adaptive, guide
        law, adaptive_state = control(
            before, session.adaptive, sample, T_measured, gains=pi, tools=self._tools
        )
        return law, adaptive_state, None

    def _sent(self, robot: RobotState | None) -> pin.SE3 | None:
        """Return the TCP pose sent to the arm last, None if the robot does not report it."""
        if robot is None or robot.sent is None:
            return None
        return pose_of(robot.sent) * self._T_flange_tcp

    def _limited_pose(self, command: RobotCommand | None) -> pin.SE3 | None:
        """Return the TCP pose that the arbiter commands; its limits may delay the law's."""
        if command is None or command.pose is None:
            return None
        return pose_of(command.pose) * self._T_flange_tcp

    @staticmethod
    def _motion(session: ForceSession, law: LawState, T_measured: pin.SE3) -> ToolMotion:
        """Return the measured motion: a command in flight has changed no force yet."""
        return motion_between(session.T_measured or T_measured, T_measured, law.lever_m)

    def _approach_N(self, session: ForceSession) -> float:
        """Return the largest set point during the approach.

        The controller has no approach speed: without contact it moves at gain times set point, also
        while no wrench is received. This limits it to the approach speed of the law on the PC.
        """
        if session.request.host != "controller" or session.law.contact != "approach":
            return inf
        gains, press_axis = session.sent or self._gains, session.law.T_base_tcp.rotation[:, 2]
        gain = float((press_axis * press_axis) @ np.array(gains.force_i_m_per_Ns))
        return self._tools.plain.approach_m_s / gain if gain > 0.0 else inf

    def _ramp(self, now_N: float, target_N: float, dt_s: float) -> float:
        step_N = self._cell.force.setpoint_ramp_N_s * dt_s
        return min(max(target_N, now_N - step_N), now_N + step_N)

    def _feedback(self, session: ForceSession) -> Feedback:
        law = session.law
        R_base_flange = (law.T_base_tcp * self._T_tcp_flange).rotation
        lever_m = np.zeros(3) if law.lever_m is None else R_base_flange.T @ law.lever_m
        return Feedback(
            mode=session.request.mode,
            setpoint_force_N=vec3(-session.setpoint_N * law.T_base_tcp.rotation[:, 2]),
            lever_m=vec3(lever_m),
            gains=session.sent or self._gains,
        )

    def _stop_unless_allowed(self, now_ns: int) -> None:
        """End the session when the arbiter holds: nothing resumes by itself after a hold."""
        if self._session is None:
            return
        status = self._arbiter.read(now_ns)
        arbiter = status.fresh
        if arbiter is None:
            self._end(status.fault)
        elif not arbiter.operational:
            self._end(f"the arbiter is {arbiter.state}")
        elif arbiter.lease != self._session.lease:  # held and armed again between two readings
            self._end("the arm was armed again")
        elif commander := active_commander(arbiter):
            self._end(f"the {commander} commands the arm")

    def _end(self, reason: str) -> None:
        if (session := self._session) is not None:
            self._contact_stiffness, self._yielded = (
                last_identified(session.adaptive),
                (session.lease, session.watch.yielding),
            )
        self._session, self._stop_reason, self.fault = None, reason, ""

    def _serve(self, now_ns: int, wrench: Reading[WrenchAtTcp], robot: Reading[RobotState]) -> None:
        for start in self._starts.take_all():
            start.reply(self._start(start.request, now_ns, wrench, robot))
        for stop in self._stops.take_all():
            self._end(STOPPED)
            stop.reply(
                Reply(accepted=True, text="force feedback is off; the arm stays where it is")
            )
        for change in self._gain_requests.take_all():
            self._gains = merged_gains(self._gains, change.request, self._cell)
            text = instability(self._cell, self._gains)
            change.reply(Reply(accepted=True, text=text, gains=self._gains))
        for path in self._paths.take_all():
            path.reply(self._follow_path(path.request))

    def _start(
        self,
        request: ForceStartRequest,
        now_ns: int,
        wrench: Reading[WrenchAtTcp],
        robot: Reading[RobotState],
    ) -> Reply:
        arbiter = self._arbiter.read(now_ns).fresh
        worse: Reading[Any] = wrench if wrench.fault else robot
        refused = refused_start(request, self._cell, arbiter, worse)
        if refused is not None or robot.fresh is None or wrench.fresh is None or arbiter is None:
            return refused or refusal(worse.code, worse.fault)
        T_measured = pose_of(robot.fresh) * self._T_flange_tcp
        refused = refused_axes(request, T_measured.rotation) or refused_guide(request, wrench.fresh)
        if refused is not None:
            return refused
        if request.preset is not None:
            self._gains = tune(self._cell, request.preset).gains
        guide = admittance.begin(T_measured) if request.law == "admittance" else None
        running = self._session
        if running is not None and running.request.host == request.host and not running.failure:
            adaptive_state = self._initial_adaptive_state(
                request, running.law.T_base_tcp, robot.fresh, running.adaptive
            )
            running = replace(
                running,
                request=request,
                watch=kept_over_restart(running.watch),
                adaptive=adaptive_state,
            )
            guide = guide and (running.guide or guide)
            self._session = replace(running, guide=guide, path=None)
            return self._started(request)
        law = start_at(T_measured)
        stamp_ns = wrench.header.stamp_ns if wrench.header else now_ns
        adaptive_state = self._initial_adaptive_state(request, law.T_base_tcp, robot.fresh, None)
        setpoint_N = first_setpoint_N(
            np.array(wrench.fresh.force_N), T_measured, request.setpoint_N
        )
        watched = GuardState()
        if self._yielded is not None and self._yielded[0] == arbiter.lease:
            watched = GuardState(yielding=self._yielded[1])
        self._session = ForceSession(
            request,
            setpoint_N,
            law,
            stamp_ns,
            arbiter.lease,
            watched,
            self._gains,
            adaptive_state,
            guide,
        )
        return self._started(request)

    def _law_of(self, request: ForceStartRequest) -> StartLaw:
        """Return the law that runs: the plain one outside the adaptive law's measured range."""
        law = request.law or self._cell.force.law
        return "plain" if law == "adaptive" and softest_N_m(self._cell) is None else law

    def _started(self, request: ForceStartRequest) -> Reply:
        text = describe(request, self._law_of(request))
        requested_law = request.law or self._cell.force.law
        remarks = restriction(self._cell) if requested_law == "adaptive" else ""
        return Reply(accepted=True, text=f"{text}; {remarks}" if remarks else text)

    def _follow_path(self, request: PathRequest) -> Reply:
        session = self._session
        refused = refused_path(request, session, self._cell)
        if refused is not None or session is None:
            return refused or refusal("not_armed", "no force feedback is running")
        self._session = replace(session, path=next_path(session, request))
        return Reply(accepted=True, text=f"the tool follows {len(request.points_m)} points")

    def _initial_adaptive_state(
        self,
        request: ForceStartRequest,
        T_command: pin.SE3,
        robot: RobotState,
        running: AdaptiveState | None,
    ) -> AdaptiveState | None:
        """Return the initial state of the adaptive law, None for the plain law."""
        if self._law_of(request) != "adaptive":
            return None
        if running is not None:
            return running
        T_measured = pose_of(robot) * self._T_flange_tcp
        k = None if self._contact_stiffness is None else self._contact_stiffness.at_pose(T_measured)
        return adaptive.begin(T_command, T_measured, self._tools.adaptive, k)
