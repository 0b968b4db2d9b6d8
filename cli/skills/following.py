"""Path following at constant press force: press at the start, then move along the path."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin

from cli.skills.contact_monitor import (
    ContactMonitor,
    ContactSample,
    Debounce,
    ReportProgress,
    force_ends,
    no_progress,
)
from cli.skills.pressing import BAND_N, STEADY_S, ForceSettings
from common.bus.configured_cell import ConfiguredCell
from common.motion.frames import Array
from common.motion.limits import Limits, check_workspace
from forcemesh import topics
from forcemesh.errors import DataError
from forcemesh.messages import Vec3
from forcemesh.requests import ForceStartRequest, PathRequest

CHUNK = 50  # points in one request
AHEAD = 250  # points queued at the regulator, besides those of one request
ALONG, FLAT = (False, False, True, False, False, False), (False, False, True, True, True, False)
START_WITHIN_M = 0.02  # lateral; a path that starts farther away is rejected
BEGINNING_S = 1.0  # start of the path, not counted in the mean error
AT_REST_S = 0.2
DONE_M = 1e-5
LEAST_M = 1e-4  # shortest path


@dataclass(frozen=True, slots=True)
class FollowResult:
    """Result: press force held along a path."""

    length_mm: float
    took_s: float
    setpoint_N: float
    mean_error_N: float  # mean of the size, after the first second
    peak_error_N: float
    contacts_lost: int
    height_mm: float  # height range of the surface


@dataclass(frozen=True, slots=True)
class PathParameters:
    """Force, speed and placement of a path."""

    force_N: float
    speed_m_s: float
    from_here: bool = False  # shift the path so that it starts at the tool
    flat: bool = False  # orient the tool along the surface


def follow(
    cell: ConfiguredCell,
    points: Sequence[Array],
    way: PathParameters,
    *,
    how: ForceSettings,
    within_s: float,
    tell: ReportProgress = no_progress,
) -> FollowResult:
    """Press, then move along points across the tool's axis while the force is held.

    Args:
        cell: An armed cell.
        points: Of the TCP in base [m], each of shape (3,); their height is ignored.
        way: Force and speed.
        how: Law and gains; default: the adaptive law.
        within_s: Longest time until the force is reached [s].
        tell: Receives the progress.

    Raises:
        DataError: The path starts too far from the tool, leaves the workspace, or has no length
            across the tool's axis.
        NotReachedError: The force was not reached in time.
        RefusedError, ArmStoppedError, LostError: As raised by the client.
    """
    feeler = ContactMonitor(cell)
    start = feeler.here()
    placed = _placed(points, start.translation, start.rotation[:, 2], way)
    limits = Limits.of(cell.config)
    to_go = _left_m(placed, start.translation, start.rotation[:, 2], limits)
    request = ForceStartRequest(
        mode="both" if way.flat else "position",
        setpoint_N=way.force_N,
        law=how.law or "adaptive",
        preset=how.preset,
        axes=FLAT if way.flat else ALONG,
        frame="tool",
    )
    with force_ends(cell):
        cell.force.begin(request)
        there = Debounce(lambda felt: abs(felt.press_N - way.force_N) <= BAND_N, STEADY_S)
        feeler.until(there, within_s=within_s, what="pressing", tell=tell)
        felt = _go(cell, feeler, placed, way=way, to_go=to_go, tell=tell)
    return _judged(felt, way, to_go[0])


def _placed(points: Sequence[Array], here: Array, axis: Array, way: PathParameters) -> list[Array]:
    """Return the points at their final positions. Raises DataError."""
    if way.from_here:
        return [point - points[0] + here for point in points]
    off = points[0] - here
    off_m = float(np.linalg.norm(off - (off @ axis) * axis))
    if off_m > START_WITHIN_M:
        text = f"the path starts {1e3 * off_m:.0f} mm away from the tool"
        raise DataError(f"{text}: move there first, or start at the tool with --from-here")
    return list(points)


def _left_m(points: list[Array], here: Array, axis: Array, limits: Limits) -> list[float]:
    """Return the path length left at each point, across the axis [m]. Raises DataError."""
    across = [point - ((point - here) @ axis) * axis for point in points]
    for number, point in enumerate(across, 1):
        trip = check_workspace(limits, pin.SE3(np.eye(3), point))
        if trip is not None:
            raise DataError(f"point {number} of the path: {trip.text}")
    left = [0.0]
    for a, b in pairwise(reversed(across)):
        left.append(left[-1] + float(np.linalg.norm(b - a)))
    if left[-1] < LEAST_M:
        raise DataError("the path has no length across the tool's axis; its height is ignored")
    return left[::-1]


def _go(
    cell: ConfiguredCell,
    feeler: ContactMonitor,
    points: list[Array],
    *,
    way: PathParameters,
    to_go: list[float],
    tell: ReportProgress,
) -> list[ContactSample]:
    """Send the points in chunks until the end of the path is reached; return the samples."""
    length_m = to_go[0]
    sent, behind, felt, done = 0, 0, [feeler.next()], Debounce(_has_arrived, AT_REST_S)
    while True:
        left_m = length_m
        if sent and felt[-1].left_m is not None:
            left_m = felt[-1].left_m + to_go[min(sent, len(points)) - 1]
        while behind < len(points) - 1 and to_go[behind] > left_m:
            behind += 1
        if sent < len(points) and sent - behind < AHEAD:
            _send(cell, points[sent : sent + CHUNK], way, append=sent > 0)
            sent += CHUNK
        felt.append(feeler.next())
        tell(length_m - left_m, length_m, f"following: {felt[-1].press_N:.1f} N")
        if done(felt[-1]) and sent >= len(points):
            return felt


def _send(cell: ConfiguredCell, points: list[Array], way: PathParameters, *, append: bool) -> None:
    asked: list[Vec3] = [(float(p[0]), float(p[1]), float(p[2])) for p in points]
    request = PathRequest(points_m=tuple(asked), append=append, speed_m_s=way.speed_m_s)
    cell.ask(topics.FORCE_PATH, request)


def _has_arrived(felt: ContactSample) -> bool:
    return felt.left_m is not None and felt.left_m <= DONE_M


def _judged(felt: list[ContactSample], way: PathParameters, length_m: float) -> FollowResult:
    began_s = felt[0].t_s
    errors_N = np.array([abs(f.press_N - way.force_N) for f in felt])
    late = np.array([f.t_s - began_s > BEGINNING_S for f in felt])
    counted = errors_N[late] if late.any() else errors_N
    touching = [f.contact == "contact" for f in felt]
    axis = felt[0].T_base_tcp.rotation[:, 2]
    heights_m = [float(f.T_base_tcp.translation @ axis) for f in felt]
    return FollowResult(
        length_mm=1e3 * length_m,
        took_s=felt[-1].t_s - began_s,
        setpoint_N=way.force_N,
        mean_error_N=float(counted.mean()),
        peak_error_N=float(errors_N.max()),
        contacts_lost=sum(a and not b for a, b in pairwise(touching)),
        height_mm=1e3 * (max(heights_m) - min(heights_m)),
    )
