"""From what was heard to what is plotted: press force, set point, errors, latency. Pure."""

from dataclasses import dataclass

import numpy as np

from common.config.cell import Cell
from common.motion.convert import pose_of
from common.motion.frames import Array, R_from_quaternion
from forcemesh.messages import RobotCommand, RobotState, WrenchAtTcp
from services.panel.watch import Snapshot

FORCES = ("press", "set point", "Fx", "Fy", "Fz")
TORQUES = ("Mx", "My", "Mz", "wanted")
ERRORS = ("x", "y", "z", "distance")
LATENCIES = ("chain",)
NAMES = (*FORCES, *TORQUES, *ERRORS, *LATENCIES)


@dataclass(frozen=True, slots=True)
class Tool:
    """Where the tool is and what it feels, in base."""

    p_tcp_m: Array  # shape (3,)
    R_base_tcp: Array  # shape (3, 3)
    force_N: Array | None  # shape (3,)
    torque_Nm: Array | None  # shape (3,)

    @property
    def press_N(self) -> float | None:
        """Force with which the tool presses along its z axis."""
        return None if self.force_N is None else -float(self.force_N @ self.R_base_tcp[:, 2])


class Readout:
    """Numbers of one cell; remembers the set point over moments in which it cannot be seen."""

    def __init__(self, cell: Cell) -> None:
        """Take the frames and the deadband out of the cell file."""
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self._deadband_N = cell.force.deadband_N
        self._setpoint_N: float | None = None
        self._taken: tuple[int, int] | None = None

    def tool(self, robot: RobotState, wrench: WrenchAtTcp | None) -> Tool:
        """Return where the tool is and what it feels."""
        T_base_tcp = pose_of(robot) * self._T_flange_tcp
        return Tool(
            p_tcp_m=np.asarray(T_base_tcp.translation),
            R_base_tcp=np.asarray(T_base_tcp.rotation),
            force_N=None if wrench is None else np.array(wrench.force_N),
            torque_Nm=None if wrench is None else np.array(wrench.torque_Nm),
        )

    def numbers(self, heard: Snapshot) -> dict[str, float]:
        """Return what is known now, by the names of `NAMES`; the rest is left out."""
        found: dict[str, float] = {}
        wrench, robot = heard.wrench.fresh, heard.robot.fresh
        if wrench is not None:
            found |= dict(zip(FORCES[2:], wrench.force_N, strict=True))
            found |= dict(zip(TORQUES[:3], wrench.torque_Nm, strict=True))
        if robot is not None:
            found |= distance_mm(heard.command.fresh, robot)
            found |= self._latency_ms(robot)
        if robot is not None and wrench is not None:
            tool = self.tool(robot, wrench)
            found["press"] = tool.press_N or 0.0
            self._setpoint_N = self._setpoint(heard, tool)
            if self._setpoint_N is not None:
                found["set point"] = self._setpoint_N
            if heard.target.fresh is not None and heard.target.fresh.mode != "position":
                found["wanted"] = 0.0  # moments are always brought to zero
        return found

    def _latency_ms(self, robot: RobotState) -> dict[str, float]:
        """Return the latency of a command that was not seen before."""
        taken = robot.accepted
        number = None if taken is None else (taken.epoch, taken.seq)
        if number == self._taken:
            return {}
        self._taken = number
        return latency_ms(robot)

    def _setpoint(self, heard: Snapshot, tool: Tool) -> float | None:
        """Return the set point, in force and along the tool, which the regulator's error shows.

        The error is shortened by the deadband, and nought inside of it: there the last one holds.
        """
        target = heard.target.fresh
        if target is None or target.mode in (None, "orientation") or tool.force_N is None:
            return None
        error_N = np.array(target.error_force_N)
        length_N = float(np.linalg.norm(error_N))
        press_N = tool.press_N or 0.0
        if length_N < 1e-9:
            last_N = self._setpoint_N
            near = last_N is not None and abs(last_N - press_N) < 3.0 * self._deadband_N
            return last_N if near else press_N
        whole_N = error_N * (length_N + self._deadband_N) / length_N
        return press_N + float(whole_N @ tool.R_base_tcp[:, 2])


def distance_mm(command: RobotCommand | None, robot: RobotState) -> dict[str, float]:
    """Return how far the flange is from where it was commanded, in base axes [mm]."""
    if command is None:
        return {}
    goal = command.goal.pose if command.kind == "goal" and command.goal is not None else None
    pose = command.pose if command.kind == "setpoint" else goal
    if pose is None:
        return {}
    off_mm = 1e3 * (np.array(robot.position_m) - np.array(pose.position_m))
    x, y, z = off_mm.tolist()
    return {"x": x, "y": y, "z": z, "distance": float(np.linalg.norm(off_mm))}


def latency_ms(robot: RobotState) -> dict[str, float]:
    """Return the time from a sensor's sample to the robot that obeyed it [ms]."""
    taken = robot.accepted
    if taken is None or taken.sensor_stamp_ns is None:
        return {}
    return {"chain": (taken.at_ns - taken.sensor_stamp_ns) / 1e6}


def flange_axes(robot: RobotState) -> Array:
    """Return the flange's axes in base as columns. Shape (3, 3)."""
    return np.asarray(R_from_quaternion(robot.orientation_xyzw))
