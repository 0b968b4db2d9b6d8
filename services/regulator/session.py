"""Session of force feedback: its request, its state and its failure. Pure."""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of, record_of
from common.motion.frames import dot, product, rotated, rotated_back, scaled
from control.axis_task import IDENTITY, AxisTask
from control.compliance import ComplianceSettings, ComplianceState, comply
from control.delay_monitor import DelayMonitor, DelayMonitorSettings, scaled_gains
from control.gains import PiGains, held_gains
from control.guards import GuardState, kept_over_restart
from control.law import LawInput, LawMotion, back_calculate
from control.laws import LAWS
from control.path_follower import PathFollower, component_across, tangent_frame
from control.timing import LoopTiming, SampleTime
from forcemesh.force_task import task_text
from forcemesh.messages import (
    ZERO3,
    ArbiterStatus,
    Asker,
    AxisState,
    Feedback,
    Gains,
    Mode,
    PoseRecord,
    RegulatorTarget,
    RobotState,
)
from forcemesh.requests import ForceStartRequest
from services.regulator.task_request import next_setpoint, ramped, same_frame, task_mode

MOVERS = ("operator", "program")  # commanders that suspend the regulator


@dataclass(frozen=True, slots=True)
class ForceOwner:
    """Client that force control belongs to, from its start to its end."""

    commander: Asker
    client: str  # name of its certificate, else of its connection; by its own account

    def __str__(self) -> str:
        """Return rank and name."""
        return f"{self.commander} {self.client or 'without a name'}"


NEW = ForceOwner("operator", "")  # until its start is accepted


@dataclass(slots=True)
class ForceSession:
    """Force feedback from its start to its stop; advanced in place."""

    request: ForceStartRequest
    law: str
    lease: int  # under which it was started
    goal: AxisTask  # with the requested set points
    task: AxisTask  # with the ramped ones
    gains: PiGains  # ramped
    motion: LawMotion
    state: Any  # of the law
    watch: GuardState
    compliance: ComplianceState
    timing: LoopTiming
    owner: ForceOwner = NEW
    axes: tuple[AxisState, ...] = ()  # of a task, at the last sample
    delay: DelayMonitor = field(default_factory=DelayMonitor)
    sent_share: float = 1.0  # of the gains sent to the controller
    rest_s: float = 0.0  # until the commands released before a late input have arrived
    path: PathFollower | None = None  # if there is one
    sent: Gains | None = None  # gains sent to the controller, from the estimated stiffness
    failed: RegulatorTarget | None = None  # latched: an input failed, or a monitor tripped

    @property
    def mode(self) -> Mode:
        """Mode of the request, or the one of its task."""
        return self.request.mode if self.request.task is None else task_mode(self.goal)

    @property
    def follows_tangent(self) -> bool:
        """Whether the task frame turns with the path."""
        return self.request.task is not None and self.request.task.frame == "path"

    def path_end(self, *, append: bool) -> pin.SE3:
        """Return where a path begins: at the end of the present one, or at the command."""
        T, path = self.motion.T_base_tcp, self.path
        if not append or path is None or path.arrived:
            return T
        T_end = path.curve.T_end
        if not path.points:
            return T_end
        ahead_m = component_across(T_end.translation - T.translation, T.rotation[:, 2])
        return pin.SE3(T.rotation, T.translation + ahead_m)


def move(
    session: ForceSession,
    sample: LawInput,
    *,
    command: PoseRecord,
    sent: PoseRecord | None,
    is_late: bool,
    T_flange_tcp: pin.SE3,
    settings: Any,
    compliance: ComplianceSettings,
    speed_max_m_s: float,
) -> None:
    """Advance the session by one sample: law, compliance, path; or rest while late.

    A late input does not tell what the commands have done: more of them would add up to a step.
    The session then restarts at the released command, behind a stalled link at the oldest one:
    newer ones were not sent. A law that predicts starts without the commands in flight, so it
    rests until they have arrived.
    """
    law, timing = LAWS[session.law], session.timing
    lags = timing.lags(command, sample.dt_s, sent)
    is_late = is_late or lags
    session.rest_s = max(0.0, session.rest_s - sample.dt_s)
    if is_late and law.predicts and session.path is None:
        session.rest_s = timing.settings.window_s
    if not is_late and session.rest_s == 0.0:
        session.state, motion = law.step(session.state, sample, settings)
        session.motion = comply(session.compliance, sample, motion, compliance)
        if session.path is not None:
            session.path, session.motion.T_base_tcp, travel = session.path.follow(
                sample, session.motion, speed_max_m_s * sample.dt_s
            )
            session.compliance.move(travel)
    elif session.path is not None:  # the pending commands contain path motion
        session.motion = back_calculate(sample.motion, sample.motion.T_base_tcp)
    else:
        T_base_tcp = session.motion.T_base_tcp  # at rest: where the rest began
        if is_late:
            T_base_tcp = pose_of(timing.restart() if lags else command) * T_flange_tcp
        session.motion = back_calculate(sample.motion, T_base_tcp)
        if law.predicts:  # the commands were not sent, so the predicted force does not occur
            session.state = law.begin(T_base_tcp, sample.T_measured, None, settings)
            session.motion.follows = False


class SetpointRamp(NamedTuple):
    """Change of a set point in one second, and the speed of an approach."""

    N_s: float
    approach_m_s: float

    @classmethod
    def of(cls, cell: CellConfig, approach_m_s: float) -> "SetpointRamp":
        """Return those of a cell."""
        return cls(cell.force.setpoint_ramp_N_s, approach_m_s)


def ramped_task(session: ForceSession, dt_s: float, gains: Gains, ramp: SetpointRamp) -> AxisTask:
    """Return the task of this sample, with a smaller press while a controller approaches.

    The controller has no approach speed: without contact it moves at gain times set point, also
    while no wrench is received. This limits it to the approach speed of the law on the PC.

    Args:
        session: Its task frame follows the path, if it does.
        dt_s: Time since the last sample.
        gains: As requested.
        ramp: Of the set points.
    """
    goal = session.goal
    if session.path is not None and session.follows_tangent:
        T = session.motion.T_base_tcp
        ahead = session.path.curve.tangent
        R = tangent_frame(goal.R_task or IDENTITY, ahead, T.rotation, dt_s)
        goal = session.goal = replace(goal, R_task=R)
    if session.request.host == "controller" and session.motion.contact == "approach":
        R = goal.R_base_task(session.motion.T_base_tcp.rotation.tolist())
        press_axis = rotated(R, goal.press_axis)
        Ki = (session.sent or gains).force_i_m_per_Ns
        gain = dot(product(press_axis, press_axis), Ki)
        if gain > 0.0 and goal.press_N > 0.0:
            most_N = ramp.approach_m_s / gain
            goal = replace(goal, force_N=scaled(goal.press_axis, min(goal.press_N, most_N)))
    return ramped(session.task, goal, ramp.N_s * dt_s)


def borne_share(
    session: ForceSession,
    command: PoseRecord,
    robot: RobotState,
    *,
    time: SampleTime,
    settings: DelayMonitorSettings,
) -> float:
    """Advance the delay monitor by one sample; return the share of the gains that it permits.

    Args:
        session: Its monitor is advanced.
        command: Released by the arbiter.
        robot: Its last report.
        time: Of the sample.
        settings: Constants of the monitor.
    """
    delay, (dt_s, pose_is_new, is_late) = session.delay, time
    if session.request.host == "pc":  # the commands of a controller's own loop are not reported
        measured_m = robot.position_m if pose_is_new else None
        delay.follow(command.position_m, measured_m, dt_s=dt_s, is_late=is_late, settings=settings)
    if pose_is_new:
        delay.follow_link(robot.link.round_trip_s, dt_s)
    delay.ramp(dt_s, settings)
    return delay.share


def valid_target(
    session: ForceSession, gains: Gains, T_tcp_flange: pin.SE3, tau_s: float
) -> RegulatorTarget:
    """Return the proposal of a session after its last sample.

    Args:
        session: Without a failure.
        gains: As requested.
        T_tcp_flange: Pose of the flange in the TCP's frame.
        tau_s: Round trip of the model.
    """
    request, motion, mode = session.request, session.motion, session.mode
    T, pose, feedback = motion.T_base_tcp, None, None
    T_base_flange = T * T_tcp_flange
    if request.host == "pc":
        pose = record_of(T_base_flange)
    else:
        R = session.task.R_base_task(T.rotation.tolist())
        # A turn about the contact moves the TCP, also along a held axis.
        lever_m = motion.lever_m if all(session.goal.force_along) else None
        feedback = Feedback(
            mode=mode,
            setpoint_force_N=scaled(rotated(R, session.task.force_N), -1.0),
            setpoint_torque_Nm=scaled(rotated(R, session.task.torque_Nm), -1.0),
            lever_m=rotated_back(T_base_flange.rotation.tolist(), lever_m or ZERO3),
            gains=held_gains(
                scaled_gains(session.sent or gains, session.sent_share), session.goal, R
            ),
        )
    target = RegulatorTarget(
        mode=mode,
        host=request.host,
        law=session.law,
        setpoint_N=session.goal.press_N if request.task else request.setpoint_N,
        pose=pose,
        feedback=feedback,
        contact=motion.contact,
        error_force_N=motion.error_force_N or ZERO3,
        error_torque_Nm=motion.error_torque_Nm or ZERO3,
        frame=request.task.frame if request.task else None,
        axes=session.axes,
        wrench_stamp_ns=session.timing.sample_ns,
        round_trip_s=tau_s + session.delay.excess_now_s,
        modelled_round_trip_s=tau_s,
        gain_share=session.delay.share,
    )
    path = session.path
    return target if path is None else target.replaced(**path.report())


def change_task(
    session: ForceSession, request: ForceStartRequest, goal: AxisTask, first: AxisTask
) -> bool:
    """Change the task of a running session; return whether its frame stays.

    Args:
        session: Advanced in place.
        request: The changed request.
        goal: Its task.
        first: The set points of a start, for axes that were not controlled.
    """
    is_same = same_frame(session.goal, goal)
    session.task = next_setpoint(session.task, first) if is_same else first
    if not is_same:  # the errors are about other axes: no proportional kick
        session.motion.error_force_N = session.motion.error_torque_Nm = None
    session.request, session.goal, session.path = request, goal, None
    session.axes, session.watch = (), kept_over_restart(session.watch)
    return is_same


def describe(session: ForceSession) -> str:
    """Return a text of what was started, including defaults from the cell file."""
    request = session.request
    preset = f" with preset {request.preset}" if request.preset else ""
    host = "the PC" if request.host == "pc" else "the controller"
    if request.task is None:
        what = f"mode {request.mode}, set point {request.setpoint_N:g} N"
    else:
        what = f"frame {request.task.frame}, {task_text(request.task)}"
    return f"force feedback is on: {what}, law {session.law}{preset}, on {host}"


def active_commander(arbiter: ArbiterStatus) -> str:
    """Return the commander that moves the arm or is next, empty if only the regulator may."""
    both = (arbiter.commander, arbiter.next_commander)
    return next(filter(MOVERS.__contains__, both), "")
