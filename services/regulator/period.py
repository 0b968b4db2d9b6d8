"""One period of force control: error, law, limits, path, monitors. Pure.

The service senses before it and publishes after it.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import dot, product, rotated, scaled
from control.axis_task import IDENTITY, AxisTask
from control.compliance import axis_states
from control.delay_monitor import DelayMonitorSettings, share_to_send
from control.gains import gains_to_send, ramped_gains, scaled_gains
from control.law import LawInput, back_calculate
from control.laws import LAWS, ControlSettings, advance
from control.monitors import MonitorSample, MonitorSettings, monitor, no_waves
from control.path_follower import tangent_frame
from control.timing import SampleTime
from forcemesh.messages import Gains, PoseRecord, RobotState, Trip, WrenchAtTcp
from services.regulator.session import ForceSession
from services.regulator.task_request import ramped


class Sensed(NamedTuple):
    """Inputs of a period, all of them fresh."""

    wrench: WrenchAtTcp
    robot: RobotState
    T_measured: pin.SE3  # of the TCP in base
    time: SampleTime
    command: PoseRecord  # of the flange: released by the arbiter
    is_limited: bool  # the arbiter has changed what was proposed


@dataclass(frozen=True, slots=True)
class PeriodSettings:
    """Constants of a period for one cell."""

    laws: dict[str, ControlSettings]
    ramp_N_s: float  # of a set point
    approach_m_s: float
    monitors: MonitorSettings
    delay: DelayMonitorSettings
    T_flange_tcp: pin.SE3

    @classmethod
    def of(cls, cell: CellConfig) -> "PeriodSettings":
        """Return those of a cell."""
        return cls(
            {name: ControlSettings.of(cell, law) for name, law in LAWS.items()},
            cell.force.setpoint_ramp_N_s,
            cell.plant.probe_m_s,
            MonitorSettings.of(cell),
            DelayMonitorSettings.of(cell),
            cell.tool.T_flange_tcp.pose,
        )


def step(
    session: ForceSession, sensed: Sensed, requested: Gains, settings: PeriodSettings
) -> Trip | None:
    """Advance a session by one sample; return the trip of the first monitor that fired."""
    before, time, request = session.motion, sensed.time, session.request
    if sensed.is_limited:  # anti-windup
        before = back_calculate(before, pose_of(sensed.command) * settings.T_flange_tcp)
    session.task = ramped_task(session, time.dt_s, requested, settings)
    session.gains = ramped_gains(session.gains, requested, time.dt_s)
    share = borne_share(session, sensed, settings.delay)
    gains, wrench = scaled_gains(session.gains, share), sensed.wrench
    sample = LawInput(
        wrench.force_N, wrench.torque_Nm, session.task, time.dt_s, gains, before,
        sensed.T_measured, time.pose_is_new, share,
    )  # fmt: skip
    move(session, sample, sensed, settings)
    if request.task is not None:
        session.axes = axis_states(request.task, sample, session.compliance)
    if request.host == "controller":
        _update_sent(session, sample, requested, settings)
    trip = monitor(session.monitored, MonitorSample.of(sample, session.motion), settings.monitors)
    if trip is not None and trip.code == "oscillation" and session.delay.lower():
        session.monitored.waves, trip = no_waves(), None  # counted anew at the lowered gains
    return trip


def move(session: ForceSession, sample: LawInput, sensed: Sensed, settings: PeriodSettings) -> None:
    """Advance the session by one sample: law, limits, path; or rest while late.

    A late input does not tell what the commands have done: more of them would add up to a step.
    The session then restarts at the released command, behind a stalled link at the oldest one:
    newer ones were not sent. A law that predicts starts without the commands in flight, so it
    rests until they have arrived.
    """
    control, timing = settings.laws[session.law], session.timing
    predicts = control.law.predicts
    lags = timing.lags(sensed.command, sample.dt_s, sensed.robot.sent)
    is_late = sensed.time.is_late or lags
    session.rest_s = max(0.0, session.rest_s - sample.dt_s)
    if is_late and predicts and session.path is None:
        session.rest_s = timing.settings.window_s
    if not is_late and session.rest_s == 0.0:
        session.state, session.motion = advance(session.state, session.compliance, sample, control)
        if session.path is not None:
            session.path, session.motion.T_base_tcp, travel = session.path.follow(
                sample, session.motion, control.limits.speed_m_s * sample.dt_s
            )
            session.compliance.move(travel)
        return
    session.compliance.rest()
    if session.path is not None:  # the pending commands contain path motion
        session.motion = back_calculate(sample.motion, sample.motion.T_base_tcp)
    else:
        T_base_tcp = session.motion.T_base_tcp  # at rest: where the rest began
        if is_late:
            pose = timing.restart() if lags else sensed.command
            T_base_tcp = pose_of(pose) * settings.T_flange_tcp
        session.motion = back_calculate(sample.motion, T_base_tcp)
        if predicts:  # the commands were not sent, so the predicted force does not occur
            session.state = control.law.begin(T_base_tcp, sample.T_measured, None, control.of_law)
            session.motion.follows = False


def ramped_task(
    session: ForceSession, dt_s: float, gains: Gains, settings: PeriodSettings
) -> AxisTask:
    """Return the task of this sample, with a smaller press while a controller approaches.

    The controller has no approach speed: without contact it moves at gain times set point, also
    while no wrench is received. This limits it to the approach speed of the law on the PC.

    Args:
        session: Its task frame follows the path, if it does.
        dt_s: Time since the last sample.
        gains: As requested.
        settings: Ramp of the set points, and speed of the approach.
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
            most_N = settings.approach_m_s / gain
            goal = replace(goal, force_N=scaled(goal.press_axis, min(goal.press_N, most_N)))
    return ramped(session.task, goal, settings.ramp_N_s * dt_s)


def borne_share(session: ForceSession, sensed: Sensed, settings: DelayMonitorSettings) -> float:
    """Advance the delay monitor by one sample; return the share of the gains that it permits."""
    delay, robot, (dt_s, pose_is_new, is_late) = session.delay, sensed.robot, sensed.time
    if session.request.host == "pc":  # the commands of a controller's own loop are not reported
        measured_m, command_m = robot.position_m if pose_is_new else None, sensed.command.position_m
        delay.follow(command_m, measured_m, dt_s=dt_s, is_late=is_late, settings=settings)
    if pose_is_new:
        delay.follow_link(robot.link.round_trip_s, dt_s)
    delay.ramp(dt_s, settings)
    return delay.share


def _update_sent(
    session: ForceSession, sample: LawInput, requested: Gains, settings: PeriodSettings
) -> None:
    """Update the gains that the controller's own loop gets."""
    control = settings.laws[session.law]
    Ki = control.law.controller_gain(session.state, requested, sample.R_base_task, control.of_law)
    session.sent = None if Ki is None else gains_to_send(session.sent, requested, Ki)
    session.sent_share = share_to_send(session.sent_share, session.delay.share)
