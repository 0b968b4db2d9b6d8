"""What a path request means: its poses, and the path that the tool follows from now on. Pure."""

from dataclasses import replace
from itertools import pairwise
from math import radians

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import Array, apart
from forcemesh.requests import PathRequest
from services.regulator.axis_task import AxisTask
from services.regulator.pose_following import path_start
from services.regulator.pose_path import PosePath
from services.regulator.tcp_path import (
    TcpPath,
    ahead_of,
    component_across,
    path_along,
    remaining_m,
)

Path = TcpPath | PosePath


def tool_poses(request: PathRequest, T_base_tcp: pin.SE3) -> list[pin.SE3]:
    """Return the poses of the TCP on a path; points are at the present height and orientation."""
    if request.poses:
        return [pose_of(each) for each in request.poses]
    R, p = T_base_tcp.rotation, T_base_tcp.translation
    aims = (component_across(np.array(point) - p, R[:, 2]) for point in request.points_m)
    return [pin.SE3(R, p + aim) for aim in aims]


def next_path(
    before: Path | None,
    request: PathRequest,
    *,
    T_base_tcp: pin.SE3,
    task: AxisTask,
    turn_rad_s: float,
) -> Path | None:
    """Return the path to follow from now on, from the speed along the present one.

    Args:
        before: The present path.
        request: The next one.
        T_base_tcp: Present command.
        task: Task of force control.
        turn_rad_s: Highest angular speed.
    """
    feed_m_s, accel_m_s2 = request.speed_m_s, request.accel_m_s2
    if request.poses:
        poses = tool_poses(request, T_base_tcp)
        if not (request.append and isinstance(before, PosePath)):
            T_start = path_start(T_base_tcp, poses[0], task)
            before = PosePath(T_start, feed_m_s, accel_m_s2, turn_rad_s, request.in_contact)
        changed = replace(
            before, feed_m_s=feed_m_s, accel_m_s2=accel_m_s2, in_contact=request.in_contact
        )
        return changed.extended(poses, request.blend_m)
    if isinstance(before, PosePath):
        before = None
    ahead = () if before is None or not request.append else before.points
    return path_along(
        ahead + tuple(np.array(point) for point in request.points_m),
        speed_m_s=feed_m_s,
        accel_m_s2=accel_m_s2,
        in_contact=request.in_contact,
        now_m_s=0.0 if before is None else before.now_m_s,
    )


def turn_limit_rad_s(cell: CellConfig) -> float:
    """Return the highest angular speed of a path.

    The arbiter slows travel and turn together: a turn beyond its limit would slow force control.
    """
    return min(cell.force.speed_max_rad_s, radians(cell.limits.speed_deg_s))


def pending(path: Path | None) -> int:
    """Return the number of points or pieces that are still to be followed."""
    if path is None:
        return 0
    return len(path.points) if isinstance(path, TcpPath) else len(path.pieces)


def largest_turn(T_from: pin.SE3, poses: list[pin.SE3]) -> tuple[int, float]:
    """Return the pose, from 1, that turns farthest from the one before it, and the angle [rad]."""
    turns_rad = [apart(a, b)[1] for a, b in pairwise([T_from, *poses])]
    largest_rad = max(turns_rad)
    return turns_rad.index(largest_rad) + 1, largest_rad


def path_ahead(path: Path, T_base_tcp: pin.SE3) -> Array:
    """Return a vector in the direction of travel, zero at the end. Base axes, shape (3,)."""
    if isinstance(path, PosePath):
        return path.tangent
    return ahead_of(path, T_base_tcp.translation)


def path_report(path: Path, T_base_tcp: pin.SE3) -> dict[str, float]:
    """Return the fields of the target that describe a path."""
    if isinstance(path, TcpPath):
        left_m = remaining_m(path, T_base_tcp.translation, T_base_tcp.rotation[:, 2])
        return {"path_left_m": left_m}
    return {
        "path_left_m": path.left_m,
        "path_missed_m": path.missed_m,
        "path_speed_m_s": path.now_m_s,
    }
