"""TCP path across the tool's axis, followed while force feedback acts along it. Pure.

Hybrid force/motion control: the points of the TCP are approached one after the other with a
trapezoidal speed profile. The part of a point along the tool's axis is ignored, because force
control decides there.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import sqrt

import numpy as np

from common.motion.frames import Array

MOST_PATH_POINTS = 600  # pending at once
SHARP = 0.9  # cosine of the corner angle from which the path stops at a point
THERE_M = 1e-6


@dataclass(frozen=True, slots=True)
class TcpPath:
    """Pending points of a path and its speed."""

    points: tuple[Array, ...]  # base axes, each of shape (3,)
    beyond_m: tuple[float, ...]  # path length from each point to the last one
    stops_m: tuple[float, ...]  # from each point to the next sharp corner, or to the last one
    speed_m_s: float
    accel_m_s2: float
    in_contact: bool  # stand still without contact
    now_m_s: float = 0.0


def routed(
    before: TcpPath | None,
    points: tuple[Array, ...],
    *,
    speed_m_s: float,
    accel_m_s2: float,
    in_contact: bool,
) -> TcpPath:
    """Return the path along points, appended to those of `before` if there is one."""
    ahead = (() if before is None else before.points) + points
    beyond_m, stops_m = [0.0], [0.0]
    after: Array | None = None
    for a, b in pairwise(reversed(ahead)):  # from the last point on
        way = a - b
        length_m = float(np.linalg.norm(way))
        goes_on = after is not None and way @ after >= SHARP * length_m * np.linalg.norm(after)
        stops_m.append(length_m + (stops_m[-1] if goes_on else 0.0))
        beyond_m.append(length_m + beyond_m[-1])
        after = way
    now_m_s = 0.0 if before is None else before.now_m_s
    return TcpPath(
        ahead,
        tuple(reversed(beyond_m)),
        tuple(reversed(stops_m)),
        speed_m_s,
        accel_m_s2,
        in_contact,
        now_m_s,
    )


def remaining_m(route: TcpPath, p: Array, axis: Array) -> float:
    """Return the path length from `p` to the last point [m], its first part across the axis."""
    if not route.points:
        return 0.0
    return float(np.linalg.norm(component_across(route.points[0] - p, axis))) + route.beyond_m[0]


def go(
    route: TcpPath, p: Array, axis: Array, *, dt_s: float, pushed_m: Array, most_m: float
) -> tuple[TcpPath, Array]:
    """Return the path after one period, and the motion across the axis in it [m]. Shape (3,).

    Args:
        route: The path so far.
        p: Commanded position of the TCP, base axes. Shape (3,).
        axis: The tool's axis, unit vector. Shape (3,).
        dt_s: Length of the period.
        pushed_m: Motion by force control in this period; the sum of both stays within most_m.
        most_m: Longest motion of a period.
    """
    route = _reached(route, p, axis)
    if not route.points:
        return replace(route, now_m_s=0.0), np.zeros(3)
    aim = component_across(route.points[0] - p, axis)
    length_m = float(np.linalg.norm(aim))
    stop_m = length_m + (route.stops_m[0] if _goes_on(route, aim) else 0.0)
    stops_m_s = sqrt(2.0 * route.accel_m_s2 * stop_m)
    faster_m_s = route.now_m_s + route.accel_m_s2 * dt_s
    speed_m_s = min(route.speed_m_s, stops_m_s, faster_m_s)
    direction = aim / length_m  # not zero: points within THERE_M have been removed
    along_m = float(pushed_m @ direction)
    room_m = sqrt(max(0.0, most_m**2 - float(pushed_m @ pushed_m) + along_m**2)) - along_m
    step_m = min(speed_m_s * dt_s, length_m, max(0.0, room_m))
    return replace(route, now_m_s=speed_m_s), step_m * direction


def component_across(way: Array, axis: Array) -> Array:
    """Return the component of a vector across a unit axis. Shapes (3,)."""
    return way - (way @ axis) * axis


def _reached(route: TcpPath, p: Array, axis: Array) -> TcpPath:
    """Return the path without the points that have been reached."""
    at = 0
    while (
        at < len(route.points)
        and np.linalg.norm(component_across(route.points[at] - p, axis)) < THERE_M
    ):
        at += 1
    if not at:
        return route
    left = route.points[at:], route.beyond_m[at:], route.stops_m[at:]
    return replace(route, points=left[0], beyond_m=left[1], stops_m=left[2])


def _goes_on(route: TcpPath, aim: Array) -> bool:
    """Return whether the path continues beyond the next point without a sharp corner."""
    if len(route.points) < 2:
        return False
    way = route.points[1] - route.points[0]
    return float(way @ aim) >= SHARP * float(np.linalg.norm(way) * np.linalg.norm(aim))
