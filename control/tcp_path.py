"""TCP path across the tool's axis, followed while force feedback acts along it. Pure.

Hybrid force/motion control: the points of the TCP are approached one after the other with a
trapezoidal speed profile. The part of a point along the tool's axis is ignored, because force
control decides there.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import sqrt

import numpy as np
import pinocchio as pin

from common.motion.convert import vec3
from common.motion.frames import Array, Rows, Speeds
from common.motion.rate_limiter import REST
from control.law import LawInput, LawMotion
from forcemesh.messages import ZERO3

MOST_PATH_POINTS = 600  # pending at once
SHARP = 0.9  # cosine of the corner angle from which the path stops at a point
POINT_REACHED_M = 1e-6
TURN_RAD_S = 6.0  # fastest turn of the tangent frame: lateral set points turn with it


@dataclass(frozen=True, slots=True)
class TcpPath:
    """Pending points of a path and its speed."""

    points: tuple[Array, ...]  # base axes, each of shape (3,)
    beyond_m: tuple[float, ...]  # path length from each point to the last one
    stops_m: tuple[float, ...]  # from each point to the next sharp corner, or to the last one
    speed_m_s: float
    accel_m_s2: float
    in_contact: bool  # stand still without contact
    turns_frame: bool  # the task frame is its tangent frame
    now_m_s: float = 0.0
    aside_m: Array | None = None  # lateral motion by force control, which the path goes along with

    @property
    def pending(self) -> int:
        """Number of points that are still to be followed."""
        return len(self.points)

    def end(self, T_base_tcp: pin.SE3) -> pin.SE3:
        """Return the pose at the end, at the present height and orientation."""
        p, R = T_base_tcp.translation, T_base_tcp.rotation
        if not self.points:
            return T_base_tcp
        return pin.SE3(R, p + component_across(self.points[-1] - p, R[:, 2]))

    def ahead(self, T_base_tcp: pin.SE3) -> Array:
        """Return the vector to the next point, zero at the end. Base axes, shape (3,)."""
        if not self.points:
            return np.zeros(3)
        p: Array = T_base_tcp.translation
        return self.points[0] - (p if self.aside_m is None else p - self.aside_m)

    def report(self, T_base_tcp: pin.SE3) -> dict[str, float]:
        """Return the fields of the target that describe the path: its length from the TCP on [m].

        The first part counts across the tool's axis.
        """
        left_m = 0.0
        if self.points:
            ahead = component_across(
                self.points[0] - T_base_tcp.translation, T_base_tcp.rotation[:, 2]
            )
            left_m = float(np.linalg.norm(ahead)) + self.beyond_m[0]
        return {"path_left_m": left_m}

    def follow(
        self, sample: LawInput, motion: LawMotion, most_m: float
    ) -> tuple["TcpPath", pin.SE3, Speeds]:
        """Return the path and the command after one period, and the motion of the reference in it.

        Args:
            sample: Input of the law.
            motion: What the law has returned.
            most_m: Longest motion of the period, of force control and path together.
        """
        path, T = self, motion.T_base_tcp
        if path.in_contact and motion.contact != "contact":
            return replace(path, now_m_s=0.0), T, REST
        pushed_m = T.translation - sample.motion.T_base_tcp.translation
        if path.turns_frame and sample.task.yields[1]:
            path = aside(path, pushed_m, np.array(sample.R_base_task)[:, 1])
        path, shift_m = advance(
            path, T.translation, T.rotation[:, 2],
            dt_s=sample.dt_s, pushed_m=pushed_m, most_m=most_m,
        )  # fmt: skip
        return path, pin.SE3(T.rotation, T.translation + shift_m), (vec3(shift_m), ZERO3)


def path_along(
    points: tuple[Array, ...],
    *,
    speed_m_s: float,
    accel_m_s2: float,
    in_contact: bool,
    turns_frame: bool = False,
    now_m_s: float = 0.0,
) -> TcpPath:
    """Return the path along points that begins at a speed `now_m_s`."""
    beyond_m, stops_m = [0.0], [0.0]
    next_segment: Array | None = None
    for a, b in pairwise(reversed(points)):  # from the last point on
        segment = a - b
        length_m = float(np.linalg.norm(segment))
        continues = (
            next_segment is not None
            and segment @ next_segment >= SHARP * length_m * np.linalg.norm(next_segment)
        )
        stops_m.append(length_m + (stops_m[-1] if continues else 0.0))
        beyond_m.append(length_m + beyond_m[-1])
        next_segment = segment
    return TcpPath(
        points,
        tuple(reversed(beyond_m)),
        tuple(reversed(stops_m)),
        speed_m_s,
        accel_m_s2,
        in_contact,
        turns_frame,
        now_m_s,
    )


def advance(
    path: TcpPath, p: Array, axis: Array, *, dt_s: float, pushed_m: Array, most_m: float
) -> tuple[TcpPath, Array]:
    """Return the path after one period, and the motion across the axis in it [m]. Shape (3,).

    Args:
        path: The path so far.
        p: Commanded position of the TCP, base axes. Shape (3,).
        axis: The tool's axis, unit vector. Shape (3,).
        dt_s: Length of the period.
        pushed_m: Motion by force control in this period; the sum of both stays within most_m.
        most_m: Longest motion of a period.
    """
    points = path.points
    if path.aside_m is not None:
        p = p - path.aside_m
    while points and np.linalg.norm(component_across(points[0] - p, axis)) < POINT_REACHED_M:
        points, beyond_m, stops_m = points[1:], path.beyond_m[1:], path.stops_m[1:]
        path = replace(path, points=points, beyond_m=beyond_m, stops_m=stops_m)
    if not points:
        return replace(path, now_m_s=0.0), np.zeros(3)
    aim = component_across(points[0] - p, axis)
    length_m = stop_m = float(np.linalg.norm(aim))
    if len(points) > 1:  # without a sharp corner at the next point, the path continues
        segment = points[1] - points[0]
        if segment @ aim >= SHARP * (np.linalg.norm(segment) * length_m):
            stop_m += path.stops_m[0]
    stops_m_s = sqrt(2.0 * path.accel_m_s2 * stop_m)
    faster_m_s = path.now_m_s + path.accel_m_s2 * dt_s
    speed_m_s = min(path.speed_m_s, stops_m_s, faster_m_s)
    direction = aim / length_m
    step_m = min(speed_m_s * dt_s, length_m, room_m(pushed_m, direction, most_m))
    return replace(path, now_m_s=speed_m_s), step_m * direction


def room_m(pushed_m: Array, direction: Array, most_m: float) -> float:
    """Return the longest motion along a direction that stays, with another one, within most_m."""
    along_m = float(pushed_m @ direction)
    return max(0.0, sqrt(max(0.0, most_m**2 - float(pushed_m @ pushed_m) + along_m**2)) - along_m)


def aside(path: TcpPath, pushed_m: Array, lateral: Array) -> TcpPath:
    """Return the path that goes along with lateral motion by force control.

    Args:
        path: The path.
        pushed_m: Motion by force control in this period, base axes. Shape (3,).
        lateral: Lateral axis of the tangent frame, unit vector. Shape (3,).
    """
    before_m = np.zeros(3) if path.aside_m is None else path.aside_m
    return replace(path, aside_m=before_m + (pushed_m @ lateral) * lateral)


def tangent_frame(R_base_task: Rows, ahead: Array, R_base_tcp: Array, dt_s: float) -> Rows:
    """Return the tangent frame after a period: x along the path, z the tool's axis.

    It turns about the tool's axis towards `ahead` (base axes, shape (3,)), at TURN_RAD_S at most,
    and keeps its direction at the end of the path.
    """
    z = R_base_tcp[:, 2]
    x = component_across(np.array(R_base_task)[:, 0], z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    ahead = component_across(ahead, z)
    if np.linalg.norm(ahead) > POINT_REACHED_M:
        most = TURN_RAD_S * dt_s
        angle = min(max(float(np.arctan2(ahead @ y, ahead @ x)), -most), most)
        x = np.cos(angle) * x + np.sin(angle) * y
        y = np.cross(z, x)
    rows: Rows = np.column_stack((x, y, z)).tolist()
    return rows


def component_across(vector: Array, axis: Array) -> Array:
    """Return the component of a vector across a unit axis. Shapes (3,)."""
    return vector - (vector @ axis) * axis
