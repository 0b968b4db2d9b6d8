"""Allowed region of the arm during calibration: box, walls, tether, floor, joint limits. Pure.

Flange, sensor and TCP are checked. Other obstacles are unknown; the user must confirm that the
box is free.
"""

from dataclasses import dataclass, replace
from math import degrees

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array, length, rotation_between
from common.motion.kinematics import ArmKinematics
from common.motion.limits import Limits

STEP_M = 0.02  # largest travel of any point between two samples of a path
MARGIN_M = 0.012  # keeps the path between two samples inside as well
JOINT_MARGIN_RAD = np.radians(3.0)
TURN_MARGIN_RAD = np.radians(2.0)
POINTS = ("flange", "sensor", "TCP")


@dataclass(frozen=True, slots=True)
class Boundaries:
    """Box and walls of the cell, with tether and floor relative to the start.

    `points_in_flange_m` has shape (3, 3): origins of flange, sensor and TCP. `floor_m` is the
    least height of any of them: obstacles below the tool are unknown.
    """

    arm: ArmKinematics
    limits: Limits
    points_in_flange_m: Array
    T_start: pin.SE3  # flange in base where the arm was armed
    floor_m: float

    @classmethod
    def of(cls, cell: CellConfig, arm: ArmKinematics, q_start: Array) -> "Boundaries":
        """Return the fence of a cell; its floor is the lowest point at q_start [rad]."""
        T_flange_sensor, T_flange_tcp = (
            cell.sensor.T_flange_sensor.pose,
            cell.tool.T_flange_tcp.pose,
        )
        points = np.array([np.zeros(3), T_flange_sensor.translation, T_flange_tcp.translation])
        T_start = arm.flange_pose(q_start)
        boundaries = cls(arm, Limits.of(cell), points, T_start, floor_m=-np.inf)
        return boundaries.with_floor(float(boundaries.points(T_start)[:, 2].min()))

    def with_floor(self, floor_m: float) -> "Boundaries":
        """Return the fence with another floor [m]."""
        return replace(self, floor_m=floor_m)

    def points(self, T_flange: pin.SE3) -> Array:
        """Return flange, sensor and TCP in base [m] for a flange pose. Shape (3, 3)."""
        return np.asarray(T_flange.translation + self.points_in_flange_m @ T_flange.rotation.T)

    def violation(self, q: Array, margin_m: float = MARGIN_M) -> str:
        """Return why joint angles q [rad] are not allowed; empty when they are."""
        low = (self.limits.joint_min_rad + JOINT_MARGIN_RAD).tolist()
        high = (self.limits.joint_max_rad - JOINT_MARGIN_RAD).tolist()
        for joint, angle in enumerate(q.tolist()):
            if not low[joint] <= angle <= high[joint]:
                return f"joint {joint + 1} would be at {degrees(angle):.0f} degrees, near its limit"
        T = self.arm.flange_pose(q)
        return self._point_violation(self.points(T), margin_m) or self._tether_violation(
            T, margin_m
        )

    def path_violation(self, q_from: Array, q_to: Array, margin_m: float = MARGIN_M) -> str:
        """Return why the straight joint-space path is not allowed; empty when it is."""
        change_rad = q_to - q_from
        count = max(1, int(np.ceil(self._farthest_m(change_rad) / STEP_M)))
        for k in range(count + 1):
            found = self.violation(q_from + (k / count) * change_rad, margin_m)
            if found:
                return found
        return ""

    def _farthest_m(self, change_rad: Array) -> float:
        """Return an upper bound [m] of the travel of any point for joint changes [rad]."""
        tool_m = float(np.linalg.norm(self.points_in_flange_m, axis=1).max())
        return float(np.abs(change_rad) @ (self.arm.levers_m + tool_m))

    def _point_violation(self, points: Array, margin_m: float) -> str:
        limits, places = self.limits, points.tolist()
        # Plain floats: half the time of an array for nine values; a plan calls this 15 000 times.
        low = (limits.workspace_min_m + margin_m).tolist()
        high = (limits.workspace_max_m - margin_m).tolist()
        for point, place in zip(POINTS, places, strict=True):
            for axis, value_m in enumerate(place):
                if value_m < low[axis] or value_m > high[axis]:
                    return (
                        f"the {point} would be at {'xyz'[axis]} = {1e3 * value_m:.0f} mm, outside"
                        " the workspace box or too near to its wall"
                    )
        for number, plane in enumerate(limits.planes, start=1):
            inside_m = (points - plane.point_m) @ plane.normal
            if inside_m.min() < margin_m:
                return (
                    f"the {POINTS[int(inside_m.argmin())]} would be behind or near plane {number}"
                )
        lowest = min(range(len(places)), key=lambda point: places[point][2])
        if places[lowest][2] < self.floor_m:
            return f"the {POINTS[lowest]} would be lower than the tool is now"
        return ""

    def _tether_violation(self, T: pin.SE3, margin_m: float) -> str:
        limits = self.limits
        if length(T.translation - self.T_start.translation) > limits.tether_m - margin_m:
            return "the flange would move farther than limits.tether_m from here"
        turn_rad = length(rotation_between(self.T_start.rotation, T.rotation))
        if turn_rad > limits.tether_rad - TURN_MARGIN_RAD:
            return "the flange would turn farther than limits.tether_deg from here"
        return ""
