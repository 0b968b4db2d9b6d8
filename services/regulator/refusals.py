"""Preconditions of a start of force feedback and of a path. Pure."""

from math import degrees
from typing import Any

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array
from common.motion.limits import Limits, check_workspace
from common.motion.permission import outranks
from control.gain_rule import instability
from control.laws import LAWS
from forcemesh.bus import Reading
from forcemesh.faults import tripped
from forcemesh.force_task import AXIS_NAMES
from forcemesh.messages import ArbiterStatus, Gains, Trip
from forcemesh.requests import (
    LARGEST_BETWEEN_RAD,
    ForceStartRequest,
    GainsRequest,
    PathRequest,
)
from services.regulator.path_request import MOST_PATH_POINTS, largest_turn
from services.regulator.session import ForceOwner, ForceSession, active_commander
from services.regulator.task_refusals import task_mistake

ACROSS = 0.1  # sine of the angle to the tool's axis from which an axis moves across it
LEAST_PRESS_SHARE = 0.7  # least share of the tool's axis within the free axes: 45 degrees


def refused_start(
    request: ForceStartRequest, cell: CellConfig, arbiter: ArbiterStatus | None, worse: Reading[Any]
) -> Trip | None:
    """Return why force feedback cannot start, None when it can; `worse`: input with a fault."""
    largest_N = cell.force.setpoint_max_N
    if request.host not in cell.robot.hosts:
        text = (
            f"host {request.host} needs a cell with a controller that can run force feedback; "
            f"this cell offers {', '.join(cell.robot.hosts)}"
        )
        return tripped("host", text)
    if request.host == "controller" and not all(request.axes):
        return tripped("host", "axes: host controller cannot lock single axes, host pc can")
    if request.task is not None and (text := task_mistake(request.task, request)):
        return tripped("malformed", text)
    law = request.law or cell.force.law
    if law not in LAWS:
        return tripped("malformed", f"law: must be {' or '.join(LAWS)}, found {law!r}")
    if request.setpoint_N > largest_N:
        text = "set point above force.setpoint_max_N"
        return tripped("setpoint", text, value=request.setpoint_N, limit=largest_N)
    return _not_ready(arbiter, worse)


def _not_ready(arbiter: ArbiterStatus | None, worse: Reading[Any]) -> Trip | None:
    """Return why nothing can start now, None when it can."""
    if arbiter is None or not arbiter.operational:
        state = "silent" if arbiter is None else arbiter.state
        return tripped("not_armed", f"the arbiter is {state}: arm first")
    if arbiter.armed_for != "all":
        purpose = "jog" if arbiter.armed_for == "jog" else "backing off"
        return tripped("not_armed", f"armed for {purpose} alone: hold, then arm for all")
    if commander := active_commander(arbiter):
        text = f"the {commander} commands the arm: wait for the move to end, or hold"
        return tripped("busy", text)
    return tripped(worse.code, worse.fault) if worse.fault else None


def refused_owner(session: ForceSession | None, asker: ForceOwner) -> Trip | None:
    """Return why a client may not change force control, None when it may.

    The owner may, and a higher rank, which then owns it. A session that failed has ended.
    """
    if session is None or session.failed is not None or asker == session.owner:
        return None
    if outranks(asker.commander, session.owner.commander):
        return None
    return tripped("busy", f"force control belongs to the {session.owner}, not to the {asker}")


def refused_gains(request: GainsRequest, gains: Gains, cell: CellConfig) -> Trip | None:
    """Return why new gains are refused, None when they are not."""
    text = instability(cell, gains)
    return (
        None
        if not text or request.accept_unstable or not request.changes
        else tripped("unstable_gains", text)
    )


def refused_axes(request: ForceStartRequest, R_base_tcp: Array) -> Trip | None:
    """Return why a set point cannot be reached with these axes, None when it can.

    The set point acts along the tool's z axis. With that axis locked, the force is not controlled.

    Args:
        request: The request.
        R_base_tcp: Measured orientation of the tool, shape (3, 3).
    """
    if request.task or request.mode == "orientation" or request.setpoint_N <= 0.0:
        return None
    press_axis = np.array([0.0, 0.0, 1.0]) if request.frame == "tool" else R_base_tcp[:, 2]
    share = float(np.linalg.norm(press_axis * np.array(request.axes[:3])))
    if share >= LEAST_PRESS_SHARE:
        return None
    named = ",".join(name for name, free in zip(AXIS_NAMES, request.axes, strict=True) if free)
    text = (
        f"a set point of {request.setpoint_N:g} N presses along the tool's z axis, and the axes "
        f"that may move ({named or 'none'}, frame {request.frame}) exclude it: free that axis, "
        "or use set point 0"
    )
    return tripped("axes", text)


def refused_path(
    request: PathRequest, session: ForceSession, poses: list[pin.SE3], cell: CellConfig
) -> Trip | None:
    """Return why a path cannot be followed, None when it can.

    Args:
        request: Points or poses.
        session: That runs.
        poses: Those of the TCP that the request means.
        cell: The cell.
    """
    started = session.request
    if started.host != "pc":
        return tripped("host", "host controller cannot follow a path, host pc can")
    if request.points_m and LAWS[session.law].predicts and shares_path(session):
        text = (
            f"the {session.law} law would take the path for an external push and return: start "
            "force feedback in frame tool, with axes x and y held"
        )
        return tripped("axes", text)
    if request.speed_m_s > cell.force.speed_max_m_s:
        most_m_s = cell.force.speed_max_m_s
        text = "path speed above force.speed_max_m_s"
        return tripped("setpoint", text, value=request.speed_m_s, limit=most_m_s)
    before = session.path if request.append else None
    count = len(poses) + (0 if before is None else before.pending)
    if count > MOST_PATH_POINTS:
        return tripped("busy", "too many pending path points", value=count, limit=MOST_PATH_POINTS)
    return _refused_poses(request, session, poses) or _pose_outside(poses, cell)


def _refused_poses(
    request: PathRequest, session: ForceSession, poses: list[pin.SE3]
) -> Trip | None:
    """Return why a path of poses cannot be followed by this task, None when it can."""
    if request.points_m and request.poses:
        return tripped("setpoint", "a path has points or poses, not both")
    if not request.poses:
        return None
    before = session.path if request.append else None
    if before is not None and before.points and not before.arrived:
        text = "poses cannot continue a path of points, whose height is free: send points"
        return tripped("setpoint", text)
    if all(session.goal.force_along):
        text = (
            "the force controls every axis, none is left to a path of poses: start force feedback "
            "with axes held, such as --axes z=force:10"
        )
        return tripped("axes", text)
    number, turn_rad = largest_turn(session.path_end(append=request.append), poses)
    if turn_rad > LARGEST_BETWEEN_RAD:
        text = f"pose {number} is turned by {degrees(turn_rad):.0f} degrees from the one before it"
        limit = LARGEST_BETWEEN_RAD
        return tripped("setpoint", text, value=turn_rad, limit=limit)
    return None


def shares_path(session: ForceSession) -> bool:
    """Return whether force control may move the tool across its axis, as a path does.

    The lateral axis of the tangent frame is left to force control.
    """
    if session.follows_tangent:
        return False
    R_base_tcp = session.motion.T_base_tcp.rotation
    R_base_task = np.array(session.goal.R_base_task(R_base_tcp.tolist()))
    across = np.sqrt(1.0 - np.minimum((R_base_tcp[:, 2] @ R_base_task) ** 2, 1.0))
    return bool(np.any(across[np.array(session.goal.force_along)] > ACROSS))


def _pose_outside(poses: list[pin.SE3], cell: CellConfig) -> Trip | None:
    """Refuse a pose of the TCP outside the workspace."""
    limits = Limits.of(cell)
    for number, T_base_tcp in enumerate(poses, start=1):
        trip = check_workspace(limits, T_base_tcp)
        if trip is not None:
            return trip.replaced(text=f"point {number}: {trip.text}")
    return None
