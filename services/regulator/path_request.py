"""What a path request means: its poses, and the path that the tool follows from now on. Pure."""

from dataclasses import replace
from itertools import pairwise
from math import radians

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import apart
from control.axis_task import AxisTask
from control.path_curve import ROTATION_RADIUS_M, PathCurve, TurnLimits
from control.pose_path import PosePath, path_start
from control.tcp_path import TcpPath, component_across, path_along
from forcemesh.requests import PathRequest

IN_PLACE_SHARE = 0.25  # of the speed of an approach, at the edge of the tool

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
    turns_frame: bool,
    predicts: bool,
    turns: TurnLimits,
) -> Path:
    """Return the path to follow from now on, from the speed along the present one.

    Args:
        before: The present path.
        request: The next one.
        T_base_tcp: Present command.
        task: Task of force control.
        turns_frame: The task frame turns with the path.
        predicts: The law has a predictor.
        turns: Highest angular speeds.
    """
    if not request.poses:
        points = before if isinstance(before, TcpPath) else None
        return _next_points(points, request, turns_frame=turns_frame)
    poses = tool_poses(request, T_base_tcp)
    if request.append and isinstance(before, PosePath):
        path = before
    else:
        T_start = path_start(T_base_tcp, poses[0], task)
        curve = PathCurve(T_start, request.speed_m_s, request.accel_m_s2, turns)
        path = PosePath(curve, request.in_contact, predicts)
    curve = replace(path.curve, feed_m_s=request.speed_m_s, accel_m_s2=request.accel_m_s2)
    curve = curve.extended(poses, request.blend_m)
    return replace(path, curve=curve, in_contact=request.in_contact)


def _next_points(before: TcpPath | None, request: PathRequest, *, turns_frame: bool) -> TcpPath:
    ahead = before.points if before is not None and request.append else ()
    return path_along(
        ahead + tuple(np.array(point) for point in request.points_m),
        speed_m_s=request.speed_m_s,
        accel_m_s2=request.accel_m_s2,
        in_contact=request.in_contact,
        turns_frame=turns_frame,
        now_m_s=0.0 if before is None else before.now_m_s,
    )


def turn_limits(cell: CellConfig) -> TurnLimits:
    """Return the highest angular speeds of a path.

    The arbiter slows travel and turn together: a turn beyond its limit would slow force control. In
    place, the edge of the tool moves at a quarter of an approach: that one may use the whole force
    budget.
    """
    rad_s = min(cell.force.speed_max_rad_s, radians(cell.limits.speed_deg_s))
    return TurnLimits(rad_s, IN_PLACE_SHARE * cell.plant.approach_m_s / ROTATION_RADIUS_M)


def largest_turn(T_from: pin.SE3, poses: list[pin.SE3]) -> tuple[int, float]:
    """Return the pose, from 1, that turns farthest from the one before it, and the angle [rad]."""
    turns_rad = [apart(a, b)[1] for a, b in pairwise([T_from, *poses])]
    largest_rad = max(turns_rad)
    return turns_rad.index(largest_rad) + 1, largest_rad
