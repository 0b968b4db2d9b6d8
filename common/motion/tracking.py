"""Tracking monitor: detects collision, HOLD on the pendant, or a slow arm. Pure.

The delay of the arm is not known exactly. So the arm must be near a pose commanded within its
delay: near the path of the last set points, on the line of a move, or at its position at rest.
The motion of force feedback in the controller is unknown to the gateway, so it is not monitored.
"""

from collections import deque
from itertools import pairwise
from math import degrees, hypot, radians
from typing import Literal

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array, apart, speeds_between
from forcemesh.faults import tripped
from forcemesh.messages import Joints, Trip

PERIODS = 5  # permitted consecutive reports off the commanded pose
# The delay in the cell file is a mean; a planning step or a full ring buffer makes it longer.
DELAY_MARGIN = 2.0
SLACK_S = 0.1

# What moves the arm. Of a stream the newest pose is valid without time limit, older ones for the
# delay; of a line all of it is valid, without time limit.
Motion = Literal["unknown", "stream", "line", "joint_move", "rest"]


class TrackingMonitor:
    """Comparison of each report with the commanded poses; more than five deviations trip."""

    def __init__(self, cell: CellConfig) -> None:
        """Begin without a command: nothing is compared."""
        self._limit_m = cell.limits.tracking_m
        self._limit_rad = radians(cell.limits.tracking_deg)
        report_s = 1.0 / cell.rates.robot_hz
        delay_s = DELAY_MARGIN * cell.plant.servo_s + report_s + SLACK_S
        self._delay_ns = round(delay_s * 1e9)
        self.free()

    def free(self) -> None:
        """Stop comparing: the motion of the arm is unknown."""
        self._motion: Motion = "unknown"
        self._poses: deque[tuple[int, pin.SE3]] = deque()  # commanded, each with its time
        self._joints: tuple[Array, Array] | None = None  # of a joint move, from and to
        self._off = 0  # reports in a row

    def stream(self, T_target: pin.SE3, now_ns: int) -> None:
        """Register a commanded set point."""
        if self._motion != "stream":
            self.free()
            self._motion = "stream"
        self._poses.append((now_ns, T_target))

    def line(self, T_from: pin.SE3, T_to: pin.SE3) -> None:
        """Register a commanded straight move."""
        self.free()
        self._motion = "line"
        self._poses.extend([(0, T_from), (0, T_to)])

    def joint_move(self, from_rad: Joints | Array, to_rad: Joints | Array) -> None:
        """Register a commanded joint move: all joints start and arrive together."""
        self.free()
        self._motion, self._joints = "joint_move", (np.array(from_rad), np.array(to_rad))

    def rest(self, T_measured: pin.SE3, *, moving: bool) -> None:
        """Register that nothing is commanded: an arm at rest must stay there."""
        if self._motion == "rest":
            return
        self.free()
        if not moving:
            self._motion = "rest"
            self._poses.append((0, T_measured))

    def judge(self, T_measured: pin.SE3, joint_rad: Joints | Array, now_ns: int) -> Trip | None:
        """Check a report; call it once for each."""
        poses, T = self._poses, T_measured
        away_m = away_rad = 0.0  # to the nearest commanded pose
        if self._joints is not None:
            from_rad, to_rad = self._joints
            away_rad = _distance_to_segment(to_rad - from_rad, joint_rad - from_rad)
        elif poses:
            # The last pose before the delay was still valid at its start.
            start_ns = now_ns - self._delay_ns
            while self._motion == "stream" and len(poses) > 1 and poses[1][0] <= start_ns:
                poses.popleft()
            away_m, away_rad = apart(poses[-1][1], T)
        # Newest first: it nearly always matches, and the rest need no check.
        for (_, b), (_, a) in pairwise(reversed(poses)):
            if away_m <= self._limit_m and away_rad <= self._limit_rad:
                break
            ends = map(np.array, speeds_between(a, b, 1.0))
            places = map(np.array, speeds_between(a, T, 1.0))
            off_m, off_rad = map(_distance_to_segment, ends, places)
            away_m, away_rad = min(away_m, off_m), min(away_rad, off_rad)
        if away_m <= self._limit_m and away_rad <= self._limit_rad:
            self._off = 0
            return None
        self._off += 1
        if self._off <= PERIODS:
            return None
        if away_m > self._limit_m:
            text = f"the arm is {away_m * 1e3:.1f} mm away from its commanded pose"
            return tripped("tracking", text, value=away_m, limit=self._limit_m, unit="m")
        text = f"the arm is {degrees(away_rad):.1f} degrees away from its commanded pose"
        return tripped("tracking", text, value=away_rad, limit=self._limit_rad, unit="rad")


def _distance_to_segment(end: Array, point: Array) -> float:
    """Return the distance of a point from a line segment, both from its start."""
    square = float(end @ end)
    share = 0.0 if square == 0.0 else min(1.0, max(0.0, float(point @ end) / square))
    return hypot(*(point - share * end))
