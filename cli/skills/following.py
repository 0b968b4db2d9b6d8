"""Path following at constant press force: press at the start, then move along the path."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot

import numpy as np
import pinocchio as pin

from cli.skills.contact_monitor import (
    ContactMonitor,
    ContactSample,
    Debounce,
    ReportProgress,
    no_progress,
    stop_force_at_end,
)
from cli.skills.pressing import BAND_N, STEADY_S
from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import vec3
from common.motion.frames import Array
from common.motion.limits import Limits, check_workspace
from forcemesh.errors import DataError, NotReachedError
from forcemesh.messages import Vec3
from forcemesh.requests import ForceStartRequest, PathRequest

CHUNK = 50  # points in one request
MOST_QUEUED = 250  # points queued at the regulator, besides those of one request
PRESS_AXES, FLAT_AXES = (
    (False, False, True, False, False, False),
    (False, False, True, True, True, False),
)
START_TOLERANCE_M = 0.02  # lateral; a path that starts farther away is rejected
BEGINNING_S = 1.0  # start of the path, not counted in the mean error
AT_REST_S = 0.2
DONE_M = 1e-5
LEAST_M = 1e-4  # shortest path
STANDSTILL_M = 1e-6  # change of the path that is left, below which it stands still


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
    worst_press_N: float
    missed_mm: float | None  # path without contact or with another force

    def text(self) -> str:
        """Return the result as a line."""
        errors = f"force error {self.mean_error_N:.2f} N mean, {self.peak_error_N:.1f} N peak"
        length = f"{self.length_mm:.0f} mm in {self.took_s:.1f} s at {self.setpoint_N:g} N"
        parts = [f"{length}: {errors}"]
        if self.missed_mm is not None:
            parts.append(f"{self.missed_mm:.1f} mm of the path missed")
        lost = self.contacts_lost
        parts.append(f"contact lost {lost} times" if lost else "contact kept")
        return "; ".join([*parts, f"height range {self.height_mm:.2f} mm"])


@dataclass(frozen=True, slots=True)
class PathParameters:
    """Speed and placement of a path."""

    speed_m_s: float
    from_here: bool = False  # shift the path so that it starts at the tool
    flat: bool = False  # orient the tool along the surface
    # Of a path of poses:
    blend_m: float = 0.0  # before and after each corner
    waits: bool = True  # for contact; otherwise the path goes on
    direction: Vec3 | None = None  # of the force, base axes; None: the tool's axis


def follow(
    cell: ConfiguredCell,
    points: Sequence[Array],
    parameters: PathParameters,
    request: ForceStartRequest,
    *,
    within_s: float,
    progress: ReportProgress = no_progress,
) -> FollowResult:
    """Press, then move along points across the tool's axis while the force is held.

    Args:
        cell: An armed cell.
        points: Of the TCP in base [m], each of shape (3,); their height is ignored.
        parameters: Speed and placement.
        request: Press force, law and gains; default: the adaptive law.
        within_s: Longest time until the force is reached, and longest standstill of the path [s].
        progress: Receives the progress.

    Raises:
        DataError: The path starts too far from the tool, leaves the workspace, or has no length
            across the tool's axis.
        NotReachedError: The force was not reached in time, or the path stood still for that time.
        RefusedError, ArmStoppedError, LostError: As raised by the client.
    """
    monitor = ContactMonitor(cell, progress)
    start = monitor.tcp_pose()
    placed = _placed_points(points, start.translation, start.rotation[:, 2], parameters)
    limits = Limits.of(cell.config)
    remaining_m = _remaining_m(placed, start.translation, start.rotation[:, 2], limits)
    start_request = request.replaced(
        mode="both" if parameters.flat else "position",
        law=request.law or "adaptive",
        axes=FLAT_AXES if parameters.flat else PRESS_AXES,
        frame="tool",
    )
    force_N = request.setpoint_N

    def part(first: int) -> PathRequest:
        points_m = tuple(vec3(point) for point in placed[first : first + CHUNK])
        return PathRequest(points_m=points_m, append=first > 0, speed_m_s=parameters.speed_m_s)

    with stop_force_at_end(cell):
        cell.force.begin(start_request)
        pressed = Debounce(lambda sample: abs(sample.press_N - force_N) <= BAND_N, STEADY_S)
        monitor.until(pressed, within_s=within_s, label="pressing")
        samples = send_parts(
            cell, monitor, part, chunk=CHUNK, remaining_m=remaining_m, still_s=within_s
        )
    return follow_result(samples, force_N, remaining_m[0])


def _placed_points(
    points: Sequence[Array], p_tcp_m: Array, axis: Array, parameters: PathParameters
) -> list[Array]:
    """Return the points at their final positions. Raises DataError."""
    if parameters.from_here:
        return [point - points[0] + p_tcp_m for point in points]
    offset = points[0] - p_tcp_m
    distance_m = hypot(*offset - (offset @ axis) * axis)
    if distance_m > START_TOLERANCE_M:
        text = f"the path starts {1e3 * distance_m:.0f} mm away from the tool"
        raise DataError(f"{text}: move there first, or start at the tool with --from-here")
    return list(points)


def _remaining_m(points: list[Array], p_tcp_m: Array, axis: Array, limits: Limits) -> list[float]:
    """Return the path length left at each point, across the axis [m]. Raises DataError."""
    lateral = [point - ((point - p_tcp_m) @ axis) * axis for point in points]
    for number, point in enumerate(lateral, 1):
        trip = check_workspace(limits, pin.SE3(np.eye(3), point))
        if trip is not None:
            raise DataError(f"point {number} of the path: {trip.text}")
    lengths_m = [0.0]
    for a, b in pairwise(reversed(lateral)):
        lengths_m.append(lengths_m[-1] + hypot(*b - a))
    if lengths_m[-1] < LEAST_M:
        raise DataError("the path has no length across the tool's axis; its height is ignored")
    return lengths_m[::-1]


@dataclass(slots=True)
class Standstill:
    """Longest standstill of a path."""

    most_s: float
    left_m: float = 0.0
    since_s: float | None = None

    def check(self, sample: ContactSample) -> None:
        """Raise NotReachedError when the path has not moved for too long."""
        left_m = self.left_m if sample.path_left_m is None else sample.path_left_m
        if self.since_s is None or abs(left_m - self.left_m) > STANDSTILL_M:
            self.left_m, self.since_s = left_m, sample.t_s
        elif sample.t_s - self.since_s > self.most_s:
            cause = "a limit keeps the tool behind" if sample.contact == "contact" else "no contact"
            text = f"the path stood still for {self.most_s:g} s, {1e3 * left_m:.1f} mm before"
            raise NotReachedError(f"{text} the end of what was sent: {cause}")


def send_parts(
    cell: ConfiguredCell,
    monitor: ContactMonitor,
    part: Callable[[int], PathRequest],
    *,
    chunk: int,
    remaining_m: list[float],
    still_s: float,
) -> list[ContactSample]:
    """Send a path in parts until its end is reached; return the samples.

    Args:
        cell: A cell that presses.
        monitor: Of its contact.
        part: Returns the request for `chunk` places from a number on.
        chunk: Places in one request.
        remaining_m: Path length left at each place.
        still_s: Longest standstill: without contact, or where a limit keeps the tool behind [s].

    Raises:
        NotReachedError: The path stood still for too long.
        RefusedError, ArmStoppedError, LostError: As raised by the client.
    """
    length_m, count = remaining_m[0], len(remaining_m)
    done = Debounce(
        lambda sample: sample.path_left_m is not None and sample.path_left_m <= DONE_M, AT_REST_S
    )
    sent, passed, samples, standstill = 0, 0, [monitor.next()], Standstill(still_s)
    while True:
        path_left_m = length_m
        if sent and samples[-1].path_left_m is not None:
            path_left_m = samples[-1].path_left_m + remaining_m[min(sent, count) - 1]
        while passed < count - 1 and remaining_m[passed] > path_left_m:
            passed += 1
        if sent < count and sent - passed < MOST_QUEUED:
            cell.force.follow(part(sent))
            sent += chunk
        samples.append(monitor.next())
        text = f"following: {samples[-1].press_N:.1f} N"
        monitor.progress(length_m - path_left_m, length_m, text)
        if done(samples[-1]) and sent >= count:
            return samples
        standstill.check(samples[-1])


def follow_result(
    samples: list[ContactSample], force_N: float, length_m: float, direction: Array | None = None
) -> FollowResult:
    """Return what was measured along a path.

    Args:
        samples: From its start to its end.
        force_N: Set point.
        length_m: Of the path.
        direction: Of the force, unit vector in base axes; None: the tool's axis. Shape (3,).
    """
    began_s = samples[0].t_s
    forces_N = np.array(
        [s.press_N if direction is None else -float(s.force_N @ direction) for s in samples]
    )
    errors_N = abs(forces_N - force_N)
    is_counted = np.array([sample.t_s - began_s > BEGINNING_S for sample in samples])
    counted = errors_N[is_counted] if is_counted.any() else errors_N
    is_in_contact = [sample.contact == "contact" for sample in samples]
    axis = samples[0].T_base_tcp.rotation[:, 2]
    heights_m = [float(sample.T_base_tcp.translation @ axis) for sample in samples]
    return FollowResult(
        length_mm=1e3 * length_m,
        took_s=samples[-1].t_s - began_s,
        setpoint_N=force_N,
        mean_error_N=float(counted.mean()),
        peak_error_N=float(errors_N.max()),
        contacts_lost=sum(a and not b for a, b in pairwise(is_in_contact)),
        height_mm=1e3 * (max(heights_m) - min(heights_m)),
        worst_press_N=float(forces_N.max()),
        missed_mm=None if samples[-1].path_missed_m is None else 1e3 * samples[-1].path_missed_m,
    )
