"""Plotted values, derived from received messages: force, set point, errors, latency. Pure."""

from typing import NamedTuple

import numpy as np

from common.config.cell import CellConfig
from common.config.info import cell_info
from common.motion.contact_point import contact_point_m
from common.motion.convert import pose_of
from common.motion.frames import Array
from forcemesh.client.force import press_force_N
from forcemesh.messages import RegulatorTarget, RobotCommand, RobotState, WrenchAtTcp
from services.panel.watch import Snapshot

FORCES = ("press", "set point", "Fx", "Fy", "Fz")
TORQUES = ("Mx", "My", "Mz", "target")
ERRORS = ("x", "y", "z", "distance")
LATENCIES = ("chain",)
NAMES = (*FORCES, *TORQUES, *ERRORS, *LATENCIES)


class Tool(NamedTuple):
    """Pose of the tool and the wrench at it, in base axes."""

    p_tcp_m: Array  # shape (3,)
    R_base_tcp: Array  # shape (3, 3)
    force_N: Array  # shape (3,), zero if unknown
    torque_Nm: Array  # shape (3,), zero if unknown

    @property
    def contact_m(self) -> Array:
        """Point at which the force acts, in base [m]; the TCP if it is unknown. Shape (3,)."""
        return self.p_tcp_m + contact_point_m(self.R_base_tcp, self.force_N, self.torque_Nm)


class Readout:
    """Plotted values of one cell; keeps the last set point while it cannot be derived."""

    def __init__(self, cell: CellConfig) -> None:
        """Read the frames and the deadband from the cell file."""
        self._T_flange_tcp = cell.tool.T_flange_tcp.pose
        self._tool = cell_info(cell).T_flange_tcp
        self._deadband_N = cell.force.deadband_N
        self._setpoint_N: float | None = None
        self._taken: tuple[int, int] | None = None

    def tool(self, robot: RobotState, wrench: WrenchAtTcp) -> Tool:
        """Return the pose of the tool and the wrench at it."""
        T_base_tcp = pose_of(robot) * self._T_flange_tcp
        return Tool(
            p_tcp_m=np.asarray(T_base_tcp.translation),
            R_base_tcp=np.asarray(T_base_tcp.rotation),
            force_N=np.array(wrench.force_N),
            torque_Nm=np.array(wrench.torque_Nm),
        )

    def numbers(self, snapshot: Snapshot) -> dict[str, float]:
        """Return the values that are known now, keyed by `NAMES`; unknown ones are left out."""
        found: dict[str, float] = {}
        wrench, robot = snapshot.wrench.fresh, snapshot.robot.fresh
        if wrench is not None:
            found |= dict(zip(FORCES[2:], wrench.force_N, strict=True))
            found |= dict(zip(TORQUES[:3], wrench.torque_Nm, strict=True))
        if robot is not None:
            found |= distance_mm(snapshot.command.fresh, robot)
            taken = robot.accepted
            number = None if taken is None else (taken.epoch, taken.seq)
            if taken is not None and taken.sensor_stamp_ns is not None and number != self._taken:
                found["chain"] = (taken.at_ns - taken.sensor_stamp_ns) / 1e6  # of a new command
            self._taken = number
        if robot is not None and wrench is not None:
            target = snapshot.target.fresh
            found["press"] = press_force_N(robot, wrench, self._tool)
            axis = self.tool(robot, wrench).R_base_tcp[:, 2]
            self._setpoint_N = self._setpoint(target, found["press"], axis)
            if self._setpoint_N is not None:
                found["set point"] = self._setpoint_N
            if target is not None and target.mode != "position":
                found["target"] = 0.0  # torques are always controlled to zero
        return found

    def _setpoint(
        self, target: RegulatorTarget | None, press_N: float, axis: Array
    ) -> float | None:
        """Return the force set point along the tool axis, derived from the regulator's error.

        The error is reduced by the deadband and zero inside it; there the last value is kept.
        """
        if target is None or target.mode in (None, "orientation"):
            return None
        error_N = np.array(target.error_force_N)
        length_N = float(np.linalg.norm(error_N))
        if length_N < 1e-9:
            last_N = self._setpoint_N
            near = last_N is not None and abs(last_N - press_N) < 3.0 * self._deadband_N
            return last_N if near else press_N
        whole_N = error_N * (length_N + self._deadband_N) / length_N
        return press_N + float(whole_N @ axis)


def distance_mm(command: RobotCommand | None, robot: RobotState) -> dict[str, float]:
    """Return measured minus commanded flange position, in base axes [mm]."""
    if command is None:
        return {}
    goal = command.goal.pose if command.kind == "goal" and command.goal is not None else None
    pose = command.pose if command.kind == "setpoint" else goal
    if pose is None:
        return {}
    off_mm = 1e3 * (np.array(robot.position_m) - np.array(pose.position_m))
    x, y, z = off_mm.tolist()
    return {"x": x, "y": y, "z": z, "distance": float(np.linalg.norm(off_mm))}
