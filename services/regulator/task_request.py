"""Task of a start request: its frame, axes and set points, and their ramp. Pure.

A mode of the specification is a row of axes: what it yields along and about is set point control,
the rest is held (`axis_task.mode_task`).
"""

from dataclasses import replace
from math import hypot

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import Rows, cross, plus, rotated_back, true_sensor
from control.axis_task import (
    IDENTITY,
    AxisLimits,
    AxisTask,
    Flags,
    VirtualMass,
    mode_task,
)
from control.compliance import resting_deadband_Nm
from forcemesh.messages import Mode, Vec3
from forcemesh.requests import ForceStartRequest, TaskAxis

SEARCHED_DEADBANDS = 2.0  # a task with a smaller force set point has no approach
TORQUE_LEVER_M = 0.1  # a torque set point rises as a force at this distance
TURN_LIMIT_RAD = 0.5  # default deviation about an axis with a torque set point: no contact ends it


def request_task(
    request: ForceStartRequest, T_base_tcp: pin.SE3, cell: CellConfig, *, mounting_rad: Vec3
) -> AxisTask:
    """Return the task of a request, with its final set points.

    Args:
        request: A checked request.
        T_base_tcp: Measured pose of the TCP.
        cell: Mounting of the sensor, deadbands.
        mounting_rad: Identified correction of this mounting, a rotation vector, from the wrench.
    """
    asked = request.task
    if asked is None:
        return mode_task(
            request.mode,
            request.setpoint_N,
            axes=request.axes,
            in_base=request.frame == "base",
            press_axis=T_base_tcp.rotation[:, 2].tolist(),
        )
    axes = asked.axes
    force_N = _three([axis.setpoint for axis in axes[:3]])
    x, y, z = (axis.control == "force" for axis in axes[:3])
    rx, ry, rz = (axis.control == "force" or _turns_freely(axis) for axis in axes[3:])
    return AxisTask(
        force_along=(x, y, z),
        torque_about=(rx, ry, rz),
        force_N=force_N,
        # Less could be noise: a contact at it would be taken for lost, and searched at full speed.
        searches=hypot(*force_N) > SEARCHED_DEADBANDS * cell.force.deadband_N,
        torque_Nm=_three([axis.setpoint for axis in axes[3:]]),
        R_task=_rotation(request, T_base_tcp, cell, mounting_rad),
        in_base=asked.frame in ("base", "pose", "path"),
        origin_m=asked.pose.position_m if asked.pose is not None else None,
        deadbands=(
            _limits([axis.deadband for axis in axes[:3]]),
            _limits([_turn_deadband(axis, cell) for axis in axes[3:]]),
        ),
        speeds=(_speeds(axes[:3]), _speeds(axes[3:])),
        turns_freely=any(map(_turns_freely, axes[3:])),
        compliant_along=tuple(map(_virtual_mass, axes[:3])),
        compliant_about=tuple(
            None if _turns_freely(axis) else _virtual_mass(axis) for axis in axes[3:]
        ),
        deviations=(
            _limits([axis.deviation_max for axis in axes[:3]]),
            _limits([_turn_limit(axis) for axis in axes[3:]]),
        ),
    )


def task_mode(task: AxisTask) -> Mode:
    """Return the mode of the specification that controls as many kinds of motion as a task."""
    turns = any(task.torque_about) or any(each is not None for each in task.compliant_about)
    moves = any(task.force_along) or any(each is not None for each in task.compliant_along)
    return "both" if turns and moves else "orientation" if turns else "position"


def same_frame(a: AxisTask, b: AxisTask) -> bool:
    """Return whether two tasks have one frame, so that values along its axes carry over."""
    return (a.R_task, a.in_base, a.origin_m) == (b.R_task, b.in_base, b.origin_m)


def first_setpoint(goal: AxisTask, force_N: Vec3, torque_Nm: Vec3, T_base_tcp: pin.SE3) -> AxisTask:
    """Return the task at the start of the set-point ramp: the measured load, at most the goal.

    An arm that already presses does not release first, and a release does not wait for a ramp.

    Args:
        goal: The task with its final set points.
        force_N: Force of the environment on the tool, base axes.
        torque_Nm: About the TCP, base axes.
        T_base_tcp: Measured pose of the TCP in base.
    """
    R = goal.R_base_task(T_base_tcp.rotation.tolist())
    arm_m = goal.arm_m(T_base_tcp.translation.tolist())
    torque_Nm = plus(torque_Nm, cross(arm_m, force_N))
    return replace(
        goal,
        force_N=_toward(goal.force_N, rotated_back(R, force_N)),
        torque_Nm=_toward(goal.torque_Nm, rotated_back(R, torque_Nm)),
    )


def next_setpoint(before: AxisTask, first: AxisTask) -> AxisTask:
    """Return the first set point of a changed task in one frame: controlled axes continue.

    Args:
        before: Present task.
        first: The changed task with the set points of a start.
    """
    return replace(
        first,
        force_N=_continued(before.force_N, first.force_N, before.force_along),
        torque_Nm=_continued(before.torque_Nm, first.torque_Nm, before.torque_about),
    )


def ramped(now: AxisTask, goal: AxisTask, step_N: float) -> AxisTask:
    """Return the task one period further towards its set points.

    Args:
        now: Task with ramped set points.
        goal: Task with final ones.
        step_N: Largest change of a force.
    """
    step_Nm = TORQUE_LEVER_M * step_N
    return replace(
        goal,
        force_N=_ramp(now.force_N, goal.force_N, step_N),
        torque_Nm=_ramp(now.torque_Nm, goal.torque_Nm, step_Nm),
    )


def _rotation(
    request: ForceStartRequest, T_base_tcp: pin.SE3, cell: CellConfig, mounting_rad: Vec3
) -> Rows | None:
    """Return the axes of the task frame, in base or in the TCP frame."""
    asked = request.task
    if asked is None or asked.frame == "tool":
        return None
    if asked.frame == "sensor":
        T_tcp_flange = cell.tool.T_flange_tcp.pose.inverse()
        T_flange_true = true_sensor(cell.sensor.T_flange_sensor.pose, mounting_rad)
        T_task: pin.SE3 = T_tcp_flange * T_flange_true
    elif asked.pose is not None:
        T_task = pose_of(asked.pose)
    elif asked.frame == "path":  # until there is a path, its tangent is the tool's x axis
        T_task = T_base_tcp
    else:
        return IDENTITY
    rows: Rows = T_task.rotation.tolist()
    return rows


def _turns_freely(axis: TaskAxis) -> bool:
    """Return whether an axis follows a turn by torque control at set point 0."""
    own = axis.mass, axis.damping, axis.stiffness or None
    return axis.control == "compliant" and own == (None, None, None)


def _turn_deadband(axis: TaskAxis, cell: CellConfig) -> float | None:
    """Return the deadband about an axis; a free one must not drift on the residual torque."""
    if axis.deadband is None and _turns_freely(axis):
        return resting_deadband_Nm(cell)
    return axis.deadband


def _virtual_mass(axis: TaskAxis) -> VirtualMass | None:
    if axis.control != "compliant":
        return None
    return VirtualMass(axis.mass, axis.damping, axis.stiffness)


def _turn_limit(axis: TaskAxis) -> float | None:
    if axis.deviation_max is None and axis.setpoint != 0.0:
        return TURN_LIMIT_RAD
    return axis.deviation_max


def _speeds(axes: tuple[TaskAxis, ...]) -> AxisLimits | None:
    limits = _limits([axis.speed_max for axis in axes])
    return None if limits == (None, None, None) else limits


def _limits(values: list[float | None]) -> AxisLimits:
    x, y, z = values
    return (x, y, z)


def _three(values: list[float]) -> Vec3:
    x, y, z = values
    return (x, y, z)


def _toward(goal: Vec3, load: Vec3) -> Vec3:
    """Return what the tool exerts, of each axis no more than the goal and of the same sign."""
    return _three([min(max(-f, min(g, 0.0)), max(g, 0.0)) for g, f in zip(goal, load, strict=True)])


def _continued(before: Vec3, start: Vec3, flags: Flags) -> Vec3:
    return _three([b if flag else s for b, s, flag in zip(before, start, flags, strict=True)])


def _ramp(now: Vec3, goal: Vec3, step: float) -> Vec3:
    return _three([min(max(g, n - step), n + step) for n, g in zip(now, goal, strict=True)])
