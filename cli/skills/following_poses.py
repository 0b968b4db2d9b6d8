"""Path of poses at constant force: the tool turns with the surface, in three dimensions."""

from collections.abc import Sequence
from itertools import pairwise
from math import degrees, hypot, radians
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin

from cli.skills import path_file
from cli.skills.contact_monitor import (
    ContactMonitor,
    ContactSample,
    Debounce,
    ReportProgress,
    no_progress,
    stop_force_at_end,
)
from cli.skills.following import (
    FLAT_AXES,
    LEAST_M,
    PRESS_AXES,
    START_TOLERANCE_M,
    FollowResult,
    PathParameters,
    follow,
    follow_result,
    send_parts,
)
from cli.skills.pressing import BAND_N, STEADY_S
from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import pose_of, record_of
from common.motion.frames import Array, apart
from common.motion.joint_paths import path_obstacle
from common.motion.joint_space import JointSpace
from common.motion.limits import Limits, check_workspace
from forcemesh.errors import DataError
from forcemesh.messages import PoseRecord, Vec3
from forcemesh.requests import (
    HELD,
    LARGEST_BETWEEN_RAD,
    ForceStartRequest,
    ForceTask,
    PathRequest,
    TaskAxis,
)

POSES_AT_ONCE = 30  # poses in one request
START_TOLERANCE_RAD = radians(15.0)  # of the tool's orientation from that of the first pose


def follow_file(
    cell: ConfiguredCell,
    path: Path,
    frame: Literal["tcp", "flange"] | None,
    parameters: PathParameters,
    *,
    request: ForceStartRequest,
    within_s: float,
    progress: ReportProgress = no_progress,
) -> FollowResult:
    """Follow the path of a file: points of the TCP, or poses of a frame. Raises as `follow_poses`.

    Args:
        cell: An armed cell.
        path: File with columns as in `path_file`.
        frame: Whose poses it has; None: points of the TCP.
        parameters: Feed and placement.
        request: Force, law and gains.
        within_s: Longest time until the force is reached [s].
        progress: Receives the progress.
    """
    if frame is None:
        points = path_file.read_points(path)
        return follow(cell, points, parameters, request, within_s=within_s, progress=progress)
    poses = path_file.read_poses(path)
    if frame == "flange":
        T_flange_tcp = cell.config.tool.T_flange_tcp.pose
        poses = [T * T_flange_tcp for T in poses]
    return follow_poses(cell, poses, parameters, request, within_s=within_s, progress=progress)


def follow_poses(
    cell: ConfiguredCell,
    poses: Sequence[pin.SE3],
    parameters: PathParameters,
    request: ForceStartRequest,
    *,
    within_s: float,
    progress: ReportProgress = no_progress,
) -> FollowResult:
    """Press, then move the TCP along poses while the force is held.

    Args:
        cell: An armed cell.
        poses: Of the TCP in base; the tool's z axis points into the surface.
        parameters: Feed, placement, blends, and the direction of the force.
        request: Force, law and gains; default: the adaptive law.
        within_s: Longest time until the force is reached [s].
        progress: Receives the progress.

    Raises:
        DataError: The path starts too far from the tool, leaves the workspace, turns too far
            between two poses, cannot be followed by the joints, or has no length.
        NotReachedError: The force was not reached in time, or the path stood still for that time.
        RefusedError, ArmStoppedError, LostError: As raised by the client.
    """
    monitor = ContactMonitor(cell, progress)
    placed = _placed_poses(poses, monitor.tcp_pose(), from_here=parameters.from_here)
    remaining_m = _remaining_m(placed, Limits.of(cell.config))
    _check_joints(cell, placed, parameters.speed_m_s)
    direction = None if parameters.direction is None else _unit(parameters.direction)
    force_N = request.setpoint_N

    def is_pressed(sample: ContactSample) -> bool:
        press_N = sample.press_N if direction is None else -float(sample.force_N @ direction)
        return abs(press_N - force_N) <= BAND_N

    def part(first: int) -> PathRequest:
        return PathRequest(
            poses=tuple(map(record_of, placed[first : first + POSES_AT_ONCE])),
            append=first > 0,
            speed_m_s=parameters.speed_m_s,
            blend_m=parameters.blend_m,
            in_contact=parameters.waits,
        )

    with stop_force_at_end(cell):
        cell.force.begin(_start(request, parameters, direction, placed[0]))
        monitor.until(Debounce(is_pressed, STEADY_S), within_s=within_s, label="pressing")
        samples = send_parts(
            cell, monitor, part,
            chunk=POSES_AT_ONCE, remaining_m=remaining_m, still_s=within_s,
        )  # fmt: skip
    return follow_result(samples, force_N, remaining_m[0], direction)


def _start(
    request: ForceStartRequest,
    parameters: PathParameters,
    direction: Array | None,
    T_first: pin.SE3,
) -> ForceStartRequest:
    """Return the request for a force along the tool's axis, or along a given direction."""
    law = request.law or "adaptive"
    if direction is None:
        return request.replaced(
            mode="both" if parameters.flat else "position",
            law=law,
            axes=FLAT_AXES if parameters.flat else PRESS_AXES,
            frame="tool",
        )
    task = ForceTask(
        frame="pose",
        pose=_frame_along(direction, T_first),
        axes=(HELD, HELD, TaskAxis(control="force", setpoint=request.setpoint_N), HELD, HELD, HELD),
    )
    return request.replaced(task=task, law=law, setpoint_N=0.0)


def _frame_along(direction: Array, T_first: pin.SE3) -> PoseRecord:
    """Return a frame whose z axis is a direction, turned the shortest way from the first pose."""
    z = T_first.rotation[:, 2]
    turn = pin.Quaternion.FromTwoVectors(z, direction).toRotationMatrix()
    return record_of(pin.SE3(turn @ T_first.rotation, T_first.translation))


def _unit(direction: Vec3) -> Array:
    size = hypot(*direction)
    if size < LEAST_M:
        raise DataError(f"direction {direction} has no length: give three numbers, such as 0 0 -1")
    return np.array(direction) / size


def _placed_poses(
    poses: Sequence[pin.SE3], T_base_tcp: pin.SE3, *, from_here: bool
) -> list[pin.SE3]:
    """Return the poses at their final positions. Raises DataError."""
    first = poses[0]
    _, away_rad = apart(first, T_base_tcp)
    if away_rad > START_TOLERANCE_RAD:
        text = f"the first pose is turned by {degrees(away_rad):.0f} degrees from the tool"
        limit = f"{degrees(START_TOLERANCE_RAD):.0f} degrees"
        raise DataError(f"{text}, at most {limit}: turn the tool first, with `forcemesh move`")
    offset_m = T_base_tcp.translation - first.translation
    if from_here:
        return [pin.SE3(T.rotation, T.translation + offset_m) for T in poses]
    z = first.rotation[:, 2]
    distance_m = hypot(*offset_m - (offset_m @ z) * z)
    if distance_m > START_TOLERANCE_M:
        text = f"the path starts {1e3 * distance_m:.0f} mm away from the tool"
        raise DataError(f"{text}: move there first, or start at the tool with --from-here")
    return list(poses)


def _remaining_m(poses: Sequence[pin.SE3], limits: Limits) -> list[float]:
    """Return the path length left at each pose [m]. Raises DataError."""
    for number, T in enumerate(poses, 1):
        trip = check_workspace(limits, T)
        if trip is not None:
            raise DataError(f"pose {number} of the path: {trip.text}")
    lengths_m = [0.0]
    for number, (b, a) in zip(range(len(poses), 1, -1), pairwise(reversed(poses)), strict=True):
        length_m, turn_rad = apart(a, b)
        if turn_rad > LARGEST_BETWEEN_RAD:
            text = f"turned by {degrees(turn_rad):.0f} degrees from the one before it"
            limit = f"{degrees(LARGEST_BETWEEN_RAD):.0f} degrees"
            raise DataError(f"pose {number} of the path: {text}, at most {limit}: add poses")
        lengths_m.append(lengths_m[-1] + length_m)
    if lengths_m[-1] < LEAST_M:
        raise DataError("the path has no length: it needs two poses in different places")
    return lengths_m[::-1]


def _check_joints(cell: ConfiguredCell, poses: Sequence[pin.SE3], speed_m_s: float) -> None:
    """Raise DataError when the joints cannot follow the whole path: parts of it are sent later."""
    T_tcp_flange, robot = cell.config.tool.T_flange_tcp.pose.inverse(), cell.state()
    flange = (T * T_tcp_flange for T in poses)
    space = JointSpace.of(cell.config)
    found = path_obstacle(space, flange, robot, pose_of(robot), speed_m_s=speed_m_s)
    if found is not None:
        raise DataError(f"pose {found.point} of the path: {found.trip.text}")
