"""The arbiter's limits once more, at the last hop before the robot: own process, config and state.

Pure: it is told what is measured and when. Every rule answers with a `Trip`.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.convert import pose_of
from common.faults import tripped
from common.frames import Array, rotation_between
from common.limits import Limits, check_joints, check_step, check_tether, check_workspace
from common.messages import Goal, Speed, Trip, Vec6

# The arbiter limits speed with its own clock and period; a set point may come a little early.
SPEED_MARGIN = 1.25
S_PER_NS = 1e-9


@dataclass(frozen=True, slots=True)
class Budget:
    """Way that set points may still go: refilled by time at the speed limit, up to one step."""

    way_m: float
    turn_rad: float
    at_ns: int
    T_base_flange: pin.SE3


class Guard:
    """Refuses goals and set points that break a limit of this cell."""

    def __init__(self, limits: Limits, T_flange_tcp: pin.SE3) -> None:
        """Keep the limits; nothing is allowed before `start`."""
        self._limits = limits
        self._T_flange_tcp = T_flange_tcp
        self._armed_at_m: Array | None = None
        self._budget: Budget | None = None

    def start(self, T_base_flange: pin.SE3) -> None:
        """Begin a lease: the tether is fastened where the arm is."""
        self._armed_at_m = np.array(T_base_flange.translation)
        self._budget = None

    def seed(self, T_base_flange: pin.SE3, now_ns: int) -> None:
        """Begin a stream of set points at this pose."""
        limits = self._limits
        self._budget = Budget(limits.step_m, limits.step_rad, now_ns, T_base_flange)

    def setpoint(self, T_wanted: pin.SE3, T_measured: pin.SE3, now_ns: int) -> Trip | None:
        """Judge a set point; one that is let through uses up its way."""
        if self._budget is None:
            return tripped("no_stream", "no stream of set points has begun")
        trip = self._place(T_wanted) or check_step(self._limits, T_measured, T_wanted)
        if trip is not None:
            return trip
        left = self._spend(self._budget, T_wanted, now_ns)
        if left.way_m < 0.0 or left.turn_rad < 0.0:
            text = "set points run faster than the speed limit"
            return tripped("speed", text, limit=self._limits.speed_m_s)
        self._budget = left
        return None

    def goal(self, goal: Goal, speed: Speed, joint_rad: Vec6) -> Trip | None:
        """Judge a move at its end; `joint_rad` is where the arm is [rad]."""
        real_m_s = speed.mechanical_m_s * speed.modular_fraction
        if real_m_s > self._limits.speed_m_s:
            text = "mechanical times modular speed is above limits.speed_m_s"
            return tripped("speed", text, value=real_m_s, limit=self._limits.speed_m_s)
        if goal.kind == "pose" and goal.pose is not None:
            return self._place(pose_of(goal.pose))
        if goal.kind != "pose" and goal.joint_rad is not None:
            start = np.array(joint_rad) if goal.kind == "by" else np.zeros(6)
            return check_joints(self._limits, start + np.array(goal.joint_rad))
        return tripped("malformed", f"a goal of kind {goal.kind} without its numbers")

    def _place(self, T_wanted: pin.SE3) -> Trip | None:
        """Judge where a flange pose lies: its tool in the workspace, itself on the tether."""
        if self._armed_at_m is None:
            return tripped("no_lease", "no lease has begun")
        trip = check_workspace(self._limits, T_wanted * self._T_flange_tcp)
        wanted_m = np.asarray(T_wanted.translation)
        return trip or check_tether(self._limits, self._armed_at_m, wanted_m)

    def _spend(self, budget: Budget, T_wanted: pin.SE3, now_ns: int) -> Budget:
        limits, elapsed_s = self._limits, (now_ns - budget.at_ns) * S_PER_NS
        grown_m = budget.way_m + SPEED_MARGIN * limits.speed_m_s * elapsed_s
        grown_rad = budget.turn_rad + SPEED_MARGIN * limits.speed_rad_s * elapsed_s
        way_m = float(np.linalg.norm(T_wanted.translation - budget.T_base_flange.translation))
        turn = rotation_between(budget.T_base_flange.rotation, T_wanted.rotation)
        return Budget(
            min(grown_m, limits.step_m) - way_m,
            min(grown_rad, limits.step_rad) - float(np.linalg.norm(turn)),
            now_ns,
            T_wanted,
        )
