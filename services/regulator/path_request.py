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
from control.path_follower import PathFollower, component_across
from forcemesh.requests import PathRequest

IN_PLACE_SHARE = 0.25  # of the speed of an approach, at the edge of the tool
MOST_PATH_POINTS = 600  # pending at once


def path_poses(request: PathRequest, T_from: pin.SE3) -> list[pin.SE3]:
    """Return the poses of the TCP on a path; points are at the height and orientation of T_from."""
    if request.poses:
        return [pose_of(each) for each in request.poses]
    R, p = T_from.rotation, T_from.translation
    aims = (component_across(np.array(point) - p, R[:, 2]) for point in request.points_m)
    return [pin.SE3(R, p + aim) for aim in aims]


def next_path(
    before: PathFollower | None,
    request: PathRequest,
    poses: list[pin.SE3],
    *,
    T_base_tcp: pin.SE3,
    task: AxisTask,
    turns_frame: bool,
    predicts: bool,
    turns: TurnLimits,
) -> PathFollower:
    """Return the path to follow from now on, from the speed along the present one.

    Args:
        before: The present path.
        request: A checked request.
        poses: Those of the TCP that it means.
        T_base_tcp: Present command.
        task: Its held axes are those that poses move.
        turns_frame: The task frame turns with the path.
        predicts: The law has a predictor.
        turns: Highest angular speeds.
    """
    path = before if request.append and before is not None and not before.arrived else None
    points = not request.poses and (path is None or path.points)
    if points and (any(task.torque_about) or any(task.compliant_about)):
        # At their own height: the tool's axis may turn on the way.
        p_m = (np.array(point) for point in request.points_m)
        poses = [pin.SE3(T.rotation, p) for T, p in zip(poses, p_m, strict=True)]
    if path is None:
        now_m_s = before.curve.now_m_s if before is not None and points else 0.0
        path = PathFollower(
            PathCurve(T_base_tcp, request.speed_m_s, request.accel_m_s2, turns, now_m_s=now_m_s),
            request.in_contact,
            predicts,
            turns_frame,
            points,
        )
        if poses:
            T_start = path.start(T_base_tcp, poses[0], task)
            path = replace(path, curve=replace(path.curve, T_joined=T_start))
    curve = replace(path.curve, feed_m_s=request.speed_m_s, accel_m_s2=request.accel_m_s2)
    curve = curve.extended(poses, request.blend_m)
    return replace(path, curve=curve, in_contact=request.in_contact, points=points)


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
