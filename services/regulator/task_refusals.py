"""Preconditions of a task per axis: what is contradictory, too large, or beyond a host. Pure."""

from math import hypot

import numpy as np

from common.config.cell import CellConfig
from common.motion.frames import Rows
from forcemesh.faults import tripped
from forcemesh.force_task import AXIS_NAMES
from forcemesh.messages import Trip
from forcemesh.requests import ForceStartRequest, ForceTask, TaskAxis

TORQUE_SHARE = 0.7  # of the torque ceiling: as force.setpoint_max_N of the force ceiling
OWN_LIMITS = ("deadband", "speed_max", "deviation_max")  # of single axes
BASE_AXIS = 0.999  # least component of an axis along the base axis that it is: 2.5 degrees


def task_mistake(task: ForceTask, request: ForceStartRequest) -> str:
    """Return what is contradictory in a request with a task, empty if nothing is."""
    if request.setpoint_N > 0.0 or not all(request.axes):
        return "task: set points and held axes belong to the axes of the task"
    if (task.frame == "pose") != (task.pose is not None):
        return "task: frame pose needs the pose of the frame in base, the others have none"
    if task.frame == "path" and task.axes[0].control != "held":
        return "task: the path moves the tool along x of frame path, so that axis must be held"
    for name, axis in zip(AXIS_NAMES, task.axes, strict=True):
        if axis.setpoint != 0.0 and axis.control != "force":
            return f"axis {name}: control {axis.control} has no set point"
        virtual = (axis.mass, axis.damping, axis.stiffness or None)
        if any(part is not None for part in virtual) and axis.control != "compliant":
            return f"axis {name}: mass, damping and stiffness need control compliant"
        if axis.control == "held" and (limit := _own_limit(axis)):
            return f"axis {name}: control held has no {limit}: it does not move"
    return ""


def refused_task(request: ForceStartRequest, cell: CellConfig, R_base_task: Rows) -> Trip | None:
    """Return why the set points or the host of a task are refused, None when they are not.

    Args:
        request: The request, without contradictions.
        cell: Ceilings of force and torque.
        R_base_task: Axes of the task in base, with the measured orientation of the tool.
    """
    task = request.task
    if task is None:
        return None
    largest_N = cell.force.setpoint_max_N
    largest_Nm = TORQUE_SHARE * cell.limits.torque_Nm
    press_N, twist_Nm = (hypot(*(axis.setpoint for axis in group)) for group in halves(task))
    if press_N > largest_N:
        text = "force set point of the task above force.setpoint_max_N"
        return tripped("setpoint", text, value=press_N, limit=largest_N)
    if twist_Nm > largest_Nm:
        text = f"torque set point of the task above {TORQUE_SHARE:g} of limits.torque_Nm"
        return tripped("setpoint", text, value=twist_Nm, limit=largest_Nm)
    if request.host == "controller":
        text = beyond_controller(task, R_base_task)
        return tripped("host", f"{text}; host pc can") if text else None
    return None


def halves(task: ForceTask) -> tuple[tuple[TaskAxis, ...], tuple[TaskAxis, ...]]:
    """Return the axes along which and about which the tool moves."""
    return task.axes[:3], task.axes[3:]


def beyond_controller(task: ForceTask, R_base_task: Rows) -> str:
    """Return what the host controller's commands cannot do of a task, empty if they can do it.

    They hold set points of force and torque about the TCP in base axes, and gains of the base axes:
    a held axis is one of gain zero.
    """
    if task.frame == "path":
        return "frame path: host controller cannot follow a path"
    if task.frame == "pose":
        return "frame pose: host controller turns about the contact, not about the frame"
    for name, axis in zip(AXIS_NAMES, task.axes, strict=True):
        if axis.control == "compliant":
            return f"axis {name}: host controller has no control compliant"
        if limit := _own_limit(axis):
            return f"axis {name}: host controller has no {limit} for single axes"
    return _held_beyond_controller(task, R_base_task)


def _own_limit(axis: TaskAxis) -> str:
    """Return the name of a limit that the axis has of its own, empty without one."""
    return next((name for name in OWN_LIMITS if getattr(axis, name) is not None), "")


def _held_beyond_controller(task: ForceTask, R_base_task: Rows) -> str:
    """Return which held axes gains of the base axes cannot hold, empty if none."""
    for group, what in zip(halves(task), ("along", "about"), strict=True):
        held = [axis.control == "held" for axis in group]
        if all(held) or not any(held):
            continue
        if task.frame != "base" and any(axis.control != "held" for axis in task.axes[3:]):
            return f"held axes {what} frame {task.frame}: host controller turns them away"
        if np.abs(R_base_task).max(axis=0).min() < BASE_AXIS:
            return f"held axes {what} frame {task.frame}: host controller can hold base axes only"
    return ""
