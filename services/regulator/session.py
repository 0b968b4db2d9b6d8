"""Session of force feedback: its request, its state and its failure. Pure."""

from dataclasses import dataclass, field
from typing import Any

import pinocchio as pin

from common.motion.convert import record_of
from common.motion.frames import rotated, rotated_back, scaled
from control.axis_task import AxisTask
from control.compliance import ComplianceState
from control.delay_monitor import DelayMonitor
from control.gains import held_gains, scaled_gains
from control.law import LawMotion
from control.monitors import MonitorState, kept_over_restart
from control.path_follower import PathFollower, component_across
from control.timing import LoopTiming
from forcemesh.force_task import task_text
from forcemesh.messages import (
    ZERO3,
    ArbiterStatus,
    Asker,
    AxisState,
    Feedback,
    Gains,
    Mode,
    RegulatorTarget,
)
from forcemesh.requests import ForceStartRequest
from services.regulator.task_request import next_setpoint, same_frame, task_mode

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
    gains: Gains  # ramped
    motion: LawMotion
    state: Any  # of the law
    monitored: MonitorState
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
    session.axes, session.monitored = (), kept_over_restart(session.monitored)
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
