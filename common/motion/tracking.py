"""Whether the arm is where it was commanded: or a collision, HOLD on the pendant, too slow. Pure.

How late the arm is nobody knows exactly. So it must be near something that it was commanded within
its delay: near the way of the last set points, on the line of a move, at the place where it rests.
Force feedback in the controller goes where the gateway does not know: there nothing is compared.
"""

from collections import deque
from dataclasses import dataclass, field
from math import degrees, radians

import numpy as np
import pinocchio as pin

from common.config.cell import Cell
from common.motion.frames import Array, length, rotation_between
from forcemesh.faults import tripped
from forcemesh.messages import Trip, Vec6

PERIODS = 5  # of reports that may be off, one after the other
# The robot's delay in the cell file is a mean; a planning step or a full ring make it longer.
DELAY_MARGIN = 2.0
SLACK_S = 0.1


@dataclass(slots=True)
class Commanded:
    """What the arm may be near: the newest entry counts for ever, an older one for the delay."""

    poses: deque[tuple[int, pin.SE3]] = field(default_factory=deque)
    is_line: bool = False  # a move: its whole line counts, however long ago it was commanded
    joints: tuple[Array, Array] | None = None  # a move of the joints, from and to


class Tracking:
    """Compares each report with what was commanded; more than five that are off are a trip."""

    def __init__(self, cell: Cell) -> None:
        """Compare nothing before something was commanded."""
        self._limit_m = cell.limits.tracking_m
        self._limit_rad = radians(cell.limits.tracking_deg)
        report_s = 1.0 / cell.rates.robot_hz
        delay_s = DELAY_MARGIN * (cell.robot.delay_s + cell.robot.lag_s) + report_s + SLACK_S
        self._delay_ns = round(delay_s * 1e9)
        self._commanded = Commanded()
        self._is_resting = False
        self._off = 0  # reports in a row

    def free(self) -> None:
        """The arm goes where we do not know: compare nothing."""
        self._commanded, self._is_resting, self._off = Commanded(), False, 0

    def stream(self, T_wanted: pin.SE3, now_ns: int) -> None:
        """A set point was commanded."""
        if self._is_resting or self._commanded.is_line or self._commanded.joints is not None:
            self.free()
        self._commanded.poses.append((now_ns, T_wanted))

    def line(self, T_from: pin.SE3, T_to: pin.SE3) -> None:
        """A straight move was commanded."""
        self.free()
        self._commanded = Commanded(deque([(0, T_from), (0, T_to)]), is_line=True)

    def turn(self, from_rad: Vec6 | Array, to_rad: Vec6 | Array) -> None:
        """A move of the joints was commanded: all start and arrive together."""
        self.free()
        self._commanded = Commanded(joints=(np.array(from_rad), np.array(to_rad)))

    def rest(self, T_measured: pin.SE3, *, moving: bool) -> None:
        """Nothing is commanded: once the arm is at rest, it has to stay there."""
        if self._is_resting:
            return
        self.free()
        if not moving:
            self._is_resting = True
            self._commanded.poses.append((0, T_measured))

    def judge(self, T_measured: pin.SE3, joint_rad: Vec6 | Array, now_ns: int) -> Trip | None:
        """Judge a report; call it once for each."""
        if self._commanded.joints is not None:
            away_m, away_rad = 0.0, _beside(*self._commanded.joints, np.array(joint_rad))
        else:
            away_m, away_rad = self._away(T_measured, now_ns)
        if away_m <= self._limit_m and away_rad <= self._limit_rad:
            self._off = 0
            return None
        self._off += 1
        if self._off <= PERIODS:
            return None
        if away_m > self._limit_m:
            text = f"the arm is {away_m * 1e3:.1f} mm away from where it was commanded"
            return tripped("tracking", text, value=away_m, limit=self._limit_m)
        text = f"the arm is {degrees(away_rad):.1f} degrees away from where it was commanded"
        return tripped("tracking", text, value=away_rad, limit=self._limit_rad)

    def _away(self, T: pin.SE3, now_ns: int) -> tuple[float, float]:
        """Return way [m] and turn [rad] to the nearest of what was commanded."""
        poses = self._commanded.poses
        if not self._commanded.is_line:
            # The one before the delay began was still in force then.
            while len(poses) > 1 and now_ns - poses[1][0] >= self._delay_ns:
                poses.popleft()
        if not poses:
            return 0.0, 0.0
        known = [pose for _, pose in poses]
        away_m = away_rad = np.inf
        # From the newest on: it nearly always is the one, and the rest need not be looked at.
        for k in range(max(1, len(known) - 1)):
            b = known[-1 - k]
            a = known[-2 - k] if len(known) > 1 else b
            away_m = min(away_m, _beside(a.translation, b.translation, T.translation))
            away_rad = min(away_rad, _turned(a, b, T))
            if away_m <= self._limit_m and away_rad <= self._limit_rad:
                break
        return away_m, away_rad


def _beside(a: Array, b: Array, point: Array) -> float:
    """Return how far a point is from a straight line's part between two others."""
    way = b - a
    square = float(way @ way)
    share = 0.0 if square == 0.0 else min(1.0, max(0.0, float((point - a) @ way) / square))
    return length(point - a - share * way)


def _turned(a: pin.SE3, b: pin.SE3, T: pin.SE3) -> float:
    """Return the angle to the nearest orientation between two [rad]."""
    turn, seen = rotation_between(a.rotation, b.rotation), rotation_between(a.rotation, T.rotation)
    return _beside(np.zeros(3), turn, seen)
