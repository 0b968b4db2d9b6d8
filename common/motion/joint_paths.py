"""Check of a path in joint space before it starts: reach, joint ranges, joint speeds. Pure.

The path is sampled and followed by inverse kinematics from the measured joint angles on, each
sample starting at the last one. A joint that already is beyond its range may move back.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from math import ceil, pi
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.motion.convert import pose_of
from common.motion.frames import Array, apart, interpolated
from common.motion.joint_space import JointSpace
from common.motion.limits import check_joints
from common.motion.paths import TURN_RADIUS_M
from forcemesh.faults import clipped, tripped
from forcemesh.messages import Goal, RobotState, Trip

SAMPLE_M = 0.02
MOST_SAMPLES = 60  # beyond one for each segment: bounds the time, which a control loop waits for


class Obstacle(NamedTuple):
    """Why a path cannot be followed."""

    point: int  # whose segment it is on, counted from 1
    trip: Trip


def move_obstacle(space: JointSpace | None, goal: Goal, robot: RobotState) -> Trip | None:
    """Return why a straight move to a pose cannot be followed; the robot limits its joint speeds.

    Moves by joint angles, and arms without a fitting model, are not checked.
    """
    if goal.pose is None or goal.kind != "pose":
        return None
    found = path_obstacle(space, [pose_of(goal.pose)], robot, pose_of(robot))
    if found is None:
        return None
    return found.trip.replaced(text=clipped(f"on the path: {found.trip.text}"))


def path_obstacle(
    space: JointSpace | None,
    poses: Iterable[pin.SE3],
    robot: RobotState,
    T_from: pin.SE3,
    *,
    speed_m_s: float | None = None,
) -> Obstacle | None:
    """Return why straight segments from one flange pose to the next cannot be followed.

    The arguments are those of `path_samples`.
    """
    return next(filter(None, path_samples(space, poses, robot, T_from, speed_m_s=speed_m_s)), None)


def path_samples(
    space: JointSpace | None,
    poses: Iterable[pin.SE3],
    robot: RobotState,
    T_from: pin.SE3,
    *,
    speed_m_s: float | None = None,
) -> Iterator[Obstacle | None]:
    """Check straight segments from one flange pose to the next sample by sample.

    Yields None for each sample that can be reached, and ends with the first obstacle. One takes
    about 0.1 ms, so a control loop takes some in each period.

    Args:
        space: Joint space of the arm.
        poses: Ends of the segments, flange in base.
        robot: Measured arm.
        T_from: Start of the first segment: the commanded pose, or the end of a path that the arm
            is still on. What leads there is not judged.
        speed_m_s: Speed along the path; None: the robot reduces it where a joint limits it.
    """
    T_measured = pose_of(robot)
    if space is None or space.misfit(T_measured, robot.joint_rad):
        return
    q = np.array(robot.joint_rad)
    T_flange_model = T_measured.actInv(space.arm.flange_pose(q))
    walk = _Walk(space, q, T_flange_model)
    segments = list(pairwise([T_measured, T_from, *poses]))
    extents_m = [
        max(length_m, TURN_RADIUS_M * turn_rad)
        for length_m, turn_rad in (apart(*segment) for segment in segments)
    ]
    sample_m = max(SAMPLE_M, sum(extents_m) / MOST_SAMPLES)
    for number, (segment, extent_m) in enumerate(zip(segments, extents_m, strict=True)):
        count = max(1, ceil(extent_m / sample_m))
        time_s = None if speed_m_s is None or number == 0 else extent_m / speed_m_s / count
        for sample in range(1, count + 1):
            trip = walk.to(interpolated(*segment, sample / count), time_s)
            if trip is not None and number > 0:
                yield Obstacle(number, trip)
                return
            yield None


def tool_path_trips(
    space: JointSpace | None,
    poses: Sequence[pin.SE3],
    robot: RobotState | None,
    T_base_tcp: pin.SE3,
    *,
    T_tcp_flange: pin.SE3,
    speed_m_s: float,
) -> Iterator[Trip | None]:
    """Check whether the joints can follow a path of the tool; the text names the point.

    Args:
        space: Joint space of the arm.
        poses: Of the TCP in base.
        robot: Measured arm; None: unknown, and the path is not checked.
        T_base_tcp: Pose of the TCP at which the path begins.
        T_tcp_flange: Pose of the flange in the TCP's frame.
        speed_m_s: Speed along the path.
    """
    if robot is None:
        return
    flange_poses = (T * T_tcp_flange for T in poses)
    for found in path_samples(
        space, flange_poses, robot, T_base_tcp * T_tcp_flange, speed_m_s=speed_m_s
    ):
        text = "" if found is None else clipped(f"point {found.point}: {found.trip.text}")
        yield found and found.trip.replaced(text=text)


class _Walk:
    """Joint angles along a path."""

    def __init__(self, space: JointSpace, q: Array, T_flange_model: pin.SE3) -> None:
        self._space, self._q, self._T_flange_model = space, q, T_flange_model
        self._limits = space.ranges_from(q)

    def to(self, T_base_flange: pin.SE3, time_s: float | None) -> Trip | None:
        """Go to the next sample; return the limit that it violates."""
        T_model = T_base_flange * self._T_flange_model
        q, reason = self._space.arm.solve(T_model, self._q, jump_rad=pi, any_range=True)
        if q is None:
            return tripped("unreachable", reason)
        turn, self._q = q - self._q, q
        if (trip := check_joints(self._limits, q)) is not None or not time_s:
            return trip
        speed_rad_s = turn / time_s
        is_slow = (abs(speed_rad_s) <= self._space.speed_rad_s).all()
        return None if is_slow else self._space.speed_trip(speed_rad_s)
