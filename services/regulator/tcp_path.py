"""A way across the tool's axis, gone while force feedback works along it. Pure.

Points of the TCP are gone to one after the other at a speed that rises and falls gently; what of a
point lies along the tool's axis does not count, because there the force has the say.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import sqrt

import numpy as np

from common.motion.frames import Array

MOST_POINTS = 600  # ahead at once
SHARP = 0.9  # cosine of a turn that is not gone round without a stop
THERE_M = 1e-6


@dataclass(frozen=True, slots=True)
class Route:
    """What is still ahead, and how fast it is gone."""

    points: tuple[Array, ...]  # base axes, each of shape (3,)
    beyond_m: tuple[float, ...]  # way left from each point to the last one
    stops_m: tuple[float, ...]  # from each point to the next sharp corner, or to the last one
    speed_m_s: float
    accel_m_s2: float
    in_contact: bool  # stand still while nothing is touched
    now_m_s: float = 0.0


def routed(
    before: Route | None,
    points: tuple[Array, ...],
    *,
    speed_m_s: float,
    accel_m_s2: float,
    in_contact: bool,
) -> Route:
    """Return the route along points, behind those of `before` if there is one."""
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
    return Route(
        ahead,
        tuple(reversed(beyond_m)),
        tuple(reversed(stops_m)),
        speed_m_s,
        accel_m_s2,
        in_contact,
        now_m_s,
    )


def left_m(route: Route, p: Array, axis: Array) -> float:
    """Return how far it is from `p` to the last point [m], across the axis at first."""
    if not route.points:
        return 0.0
    return float(np.linalg.norm(across(route.points[0] - p, axis))) + route.beyond_m[0]


def go(
    route: Route, p: Array, axis: Array, *, dt_s: float, pushed_m: Array, most_m: float
) -> tuple[Route, Array]:
    """Return the route after one period, and the motion across the axis in it [m]. Shape (3,).

    Args:
        route: What is ahead.
        p: Where the TCP is commanded to be, base axes. Shape (3,).
        axis: The tool's axis, of length one. Shape (3,).
        dt_s: Length of the period.
        pushed_m: Motion that the force has caused in this period; both together stay within
        most_m: the longest motion of a period.
    """
    route = _reached(route, p, axis)
    if not route.points:
        return replace(route, now_m_s=0.0), np.zeros(3)
    aim = across(route.points[0] - p, axis)
    length_m = float(np.linalg.norm(aim))
    stop_m = length_m + (route.stops_m[0] if _goes_on(route, aim) else 0.0)
    stops_m_s = sqrt(2.0 * route.accel_m_s2 * stop_m)
    faster_m_s = route.now_m_s + route.accel_m_s2 * dt_s
    speed_m_s = min(route.speed_m_s, stops_m_s, faster_m_s)
    direction = aim / length_m  # a point that is as near as THERE_M has been reached
    along_m = float(pushed_m @ direction)
    room_m = sqrt(max(0.0, most_m**2 - float(pushed_m @ pushed_m) + along_m**2)) - along_m
    step_m = min(speed_m_s * dt_s, length_m, max(0.0, room_m))
    return replace(route, now_m_s=speed_m_s), step_m * direction


def across(way: Array, axis: Array) -> Array:
    """Return what of a way lies across an axis of length one. Shapes (3,)."""
    return way - (way @ axis) * axis


def _reached(route: Route, p: Array, axis: Array) -> Route:
    """Leave out the points that have been reached."""
    at = 0
    while at < len(route.points) and np.linalg.norm(across(route.points[at] - p, axis)) < THERE_M:
        at += 1
    if not at:
        return route
    left = route.points[at:], route.beyond_m[at:], route.stops_m[at:]
    return replace(route, points=left[0], beyond_m=left[1], stops_m=left[2])


def _goes_on(route: Route, aim: Array) -> bool:
    """Tell whether the way goes on behind the next point without a sharp corner there."""
    if len(route.points) < 2:
        return False
    way = route.points[1] - route.points[0]
    return float(way @ aim) >= SHARP * float(np.linalg.norm(way) * np.linalg.norm(aim))
