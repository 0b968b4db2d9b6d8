"""Path of poses or points, followed while force feedback acts. Pure.

Hybrid force/motion control. A point is a pose whose height and orientation are free: only its part
across the tool's axis counts, also where force control acts there.

The command is the reference on the curve plus an offset. Along the axes that force control or
compliance moves, the offset is theirs: it turns with the task frame, so what was corrected on one
side of a workpiece is not left aside on the next. Along the others it is a deviation, which is
removed. The shape of the path is fed forward also along the force, except under a law with a
predictor: that one takes motion which is not its own for the surface's, and foresees it itself.

Where the force error grows, the feed drops, and rises again with the acceleration of the path.
"""

from dataclasses import dataclass, field, replace
from math import hypot
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.motion.convert import vec3
from common.motion.frames import Array, Rows, Speeds, dot, moved, plus, speeds_between
from common.motion.rate_limiter import REST
from control.axis_task import NONE, AxisTask, Flags, masked
from control.law import LawInput, LawMotion, limit_norm
from control.path_curve import LEAST_PIECE_M, SHARP, PathCurve
from control.shape import room_m
from forcemesh.messages import ZERO3

FULL_FEED_SHARE, FULL_FEED_N = 0.1, 1.0  # force error, of the set point and at least, at full feed
LEAST_FEED_SHARE, LEAST_FEED_N = 0.5, 3.0  # and from which on the feed is the least
LEAST_FEED = 0.1  # of the feed: an error that only motion removes must not stop it
MISSED_SHARE, MISSED_N = 0.2, 1.0  # force error beyond which the path counts as missed
BEHIND_M = 0.002  # deviation along a held axis at which the path waits for the tool
BEHIND_RAD = 0.02
SEARCH_M = 0.001  # below the height of the last contact, on a path without contact
LEAST_ACROSS = 0.1  # sine of the angle to the tool's axis: a steeper path gives the frame no x axis
TURN_RAD_S = 6.0  # fastest turn of the tangent frame: lateral set points turn with it
ACROSS: Flags = (True, True, False)  # the tool's axis


class Guided(NamedTuple):
    """Axes of a frame along and about which the path alone moves the tool."""

    along: Flags
    about: Flags
    R_base_frame: Rows


@dataclass(frozen=True, slots=True)
class PathFollower:
    """What is left of a path, and what was missed so far."""

    curve: PathCurve
    in_contact: bool  # stand still without contact
    predicts: bool  # the law has a predictor
    turns_frame: bool = False  # the task frame turns with it
    points: bool = False  # it guides the tool across its axis, whatever the task
    arrived: bool = False  # of points: at the last one
    aside_m: Array = field(default_factory=lambda: np.zeros(3))  # of points: by lateral force
    push_m: Array = field(default_factory=lambda: np.zeros(3))  # the last part of it
    behind_m: float = 0.0  # of points: from the tool to the reference
    missed_m: float = 0.0  # length travelled without contact, or with another force
    height_m: float = 0.0  # of the tool over the curve when it last had contact, press axis

    @property
    def pending(self) -> int:
        """Number of pieces and poses that are still to be followed."""
        return self.curve.pending

    def guided(self, task: AxisTask, R_base_tcp: Rows) -> Guided:
        """Return the axes that the path moves: those that the task holds, or across the tool's."""
        if self.points:
            return Guided(ACROSS, NONE, R_base_tcp)
        return Guided(*task.held, task.R_base_task(R_base_tcp))

    def start(self, T_base_tcp: pin.SE3, T_first: pin.SE3, task: AxisTask) -> pin.SE3:
        """Return the pose from which the path leads to its first pose without a step.

        It is the present command, without what it is away along the axes of force control: there
        the contact is somewhere else than the program assumes, and stays where it is.
        """
        R_first: Rows = T_first.rotation.tolist()
        along, _, R = self.guided(task, R_first)
        away_m = vec3(T_base_tcp.translation - T_first.translation)
        return pin.SE3(
            T_base_tcp.rotation, T_first.translation + np.array(masked(away_m, along, R))
        )

    def report(self) -> dict[str, float]:
        """Return the fields of the target that describe the path."""
        curve = self.curve
        return {
            "path_left_m": curve.left_m + self.behind_m,
            "path_missed_m": self.missed_m,
            "path_speed_m_s": curve.now_m_s,
        }

    def follow(
        self, sample: LawInput, motion: LawMotion, most_m: float
    ) -> tuple["PathFollower", pin.SE3, Speeds]:
        """Return the path and the command after one period, and the motion of the reference in it.

        Args:
            sample: Input of the law.
            motion: Of law and compliant axes, within its limits.
            most_m: Longest motion of the period, of force control and path together.
        """
        path, curve, T, task = self, self.curve, motion.T_base_tcp, sample.task
        touches = motion.contact == "contact"
        behind_m, behind_rad = self.behind(sample)
        if path.points:
            path = path.arriving(behind_m)
        if (path.in_contact and not touches) or path.arrived:
            return replace(path, curve=replace(curve, now_m_s=0.0)), T, REST
        before = curve.T_reference
        height_m = dot(sample.press_axis, vec3(before.translation - T.translation))
        if touches:
            path = replace(path, height_m=height_m)
        elif not path.points and path.height_m - height_m > SEARCH_M:  # it does not dive into a gap
            T = pin.SE3(T.rotation, sample.motion.T_base_tcp.translation)
        error_N = -dot(motion.error_force_N or ZERO3, sample.press_axis)
        share = feed_share(error_N, task.press_N) if touches else 1.0
        is_off = path.turns_frame and _off_tangent(sample.R_base_task, curve.tangent)
        if is_off or behind_m > BEHIND_M or behind_rad > BEHIND_RAD:
            share = 0.0
        pushed_m = T.translation - sample.motion.T_base_tcp.translation
        room = room_m(pushed_m, curve.tangent, most_m)
        if path.points:
            path = path.pushed_aside(sample, pushed_m)
            room = max(0.0, min(room, curve.feed_m_s * sample.dt_s) - path.behind_m)
        path = replace(path, curve=curve.advanced(sample.dt_s, share=share, most_m=room))
        now_m_s = path.curve.now_m_s
        if not touches or is_missed(error_N, task.press_N):
            path = replace(path, missed_m=path.missed_m + now_m_s * sample.dt_s)
        travel = speeds_between(before, path.curve.T_reference, 1.0)
        T_next = path.command(T, travel, sample=sample, most_m=most_m, pushed_m=pushed_m)
        if path.points:  # their height means nothing, neither to a spring
            travel = masked(travel[0], ACROSS, T.rotation.tolist()), ZERO3
        return path, T_next, travel

    @property
    def _T_reference(self) -> pin.SE3:
        """Pose that the tool should have, as far as the path guides it."""
        T = self.curve.T_reference
        return pin.SE3(T.rotation, T.translation + self.aside_m)

    def behind(self, sample: LawInput) -> tuple[float, float]:
        """Return by how much limits keep the tool behind [m, rad]: the path must not run away."""
        T = sample.motion.T_base_tcp
        along, about, R = self.guided(sample.task, T.rotation.tolist())
        away_m, away_rad = speeds_between(self._T_reference, T, 1.0)
        return hypot(*masked(away_m, along, R)), hypot(*masked(away_rad, about, R))

    def pushed_aside(self, sample: LawInput, pushed_m: Array) -> "PathFollower":
        """Return the path that goes along with lateral motion by force control, in frame path.

        What the arbiter has not let through of the last push is taken back.
        """
        if not self.turns_frame or sample.task.held[0][1]:
            return self
        last_m, lateral = self.push_m, np.array(sample.R_base_task)[:, 1]
        behind_m = self._T_reference.translation - sample.motion.T_base_tcp.translation
        square = max(float(last_m @ last_m), LEAST_PIECE_M**2)
        kept_m = (1.0 - min(max(float(behind_m @ last_m) / square, 0.0), 1.0)) * last_m
        push_m = (pushed_m @ lateral) * lateral
        return replace(self, aside_m=self.aside_m - last_m + kept_m + push_m, push_m=push_m)

    def arriving(self, behind_m: float) -> "PathFollower":
        """Return the path with the distance from a tool that follows points, and its arrival.

        Beyond the last point the axes are left to force control again.
        """
        arrived = self.arrived or (not self.curve.pending and behind_m < LEAST_PIECE_M)
        return replace(self, behind_m=0.0 if arrived else behind_m, arrived=arrived)

    def command(
        self,
        T: pin.SE3,
        travel: Speeds,
        *,
        sample: LawInput,
        most_m: float,
        pushed_m: Array,
    ) -> pin.SE3:
        """Return the command: what force control commands, with the travel of the reference."""
        shift_m, turn_rad = travel
        T_fed = moved(T, travel, 1.0)
        away_m, away_rad = speeds_between(self._T_reference, T_fed, 1.0)
        along, about, R = self.guided(sample.task, T_fed.rotation.tolist())
        if self.predicts or self.points:
            shift_m = masked(shift_m, along, R)
        shift_m = plus(shift_m, masked(away_m, along, R), -1.0)
        back_rad = masked(away_rad, about, R)
        most_rad = self.curve.turns.rad_s * sample.dt_s
        turn_rad = plus(turn_rad, limit_norm(back_rad, most_rad), -1.0)
        size_m = max(hypot(*shift_m), LEAST_PIECE_M)
        room = room_m(pushed_m, np.array(shift_m) / size_m, most_m)
        if self.points:  # no faster than its feed: a force may bring the tool to a stand
            room = min(room, self.curve.feed_m_s * sample.dt_s)
        return moved(T, (limit_norm(shift_m, room), turn_rad), 1.0)


def _off_tangent(R_base_task: Rows, tangent: Array) -> bool:
    """Return whether the frame is not along the path yet: the tool would leave it sideways."""
    R = np.array(R_base_task)
    across = component_across(tangent, R[:, 2])
    size = float(np.linalg.norm(across))
    return size > LEAST_ACROSS and float(R[:, 0] @ across) < SHARP * size


def tangent_frame(R_base_task: Rows, ahead: Array, R_base_tcp: Array, dt_s: float) -> Rows:
    """Return the tangent frame after a period: x along the path, z the tool's axis.

    It turns about the tool's axis towards `ahead` (unit vector, base axes, shape (3,)), at
    TURN_RAD_S at most, and keeps its direction at the end of the path.
    """
    z = R_base_tcp[:, 2]
    x = component_across(np.array(R_base_task)[:, 0], z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    ahead = component_across(ahead, z)
    if np.linalg.norm(ahead) > LEAST_ACROSS:
        most = TURN_RAD_S * dt_s
        angle = min(max(float(np.arctan2(ahead @ y, ahead @ x)), -most), most)
        x = np.cos(angle) * x + np.sin(angle) * y
        y = np.cross(z, x)
    rows: Rows = np.column_stack((x, y, z)).tolist()
    return rows


def component_across(vector: Array, axis: Array) -> Array:
    """Return the component of a vector across a unit axis. Shapes (3,)."""
    return vector - (vector @ axis) * axis


def feed_share(error_N: float, press_N: float) -> float:
    """Return the share of the feed at a force error: one up to a tenth of the set point."""
    full_N = max(FULL_FEED_N, FULL_FEED_SHARE * press_N)
    least_N = max(LEAST_FEED_N, LEAST_FEED_SHARE * press_N)
    return min(max((least_N - abs(error_N)) / (least_N - full_N), LEAST_FEED), 1.0)


def is_missed(error_N: float, press_N: float) -> bool:
    """Return whether a force error is too large for the work that the path is to do."""
    return abs(error_N) > max(MISSED_N, MISSED_SHARE * press_N)
