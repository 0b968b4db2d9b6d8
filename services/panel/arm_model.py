"""Kinematic model of the drawn arm with this cell's sensor, tool and simulated plate.

Forward kinematics only: joint angles in, poses of bodies out; no physics is stepped.
"""

import math
import os

import numpy as np

from common.config.arm import model_file, read_arm
from common.config.cell import CellConfig
from common.motion.frames import Array, quaternion_from_R

_ASKED = os.environ.get("MUJOCO_GL")
os.environ["MUJOCO_GL"] = (
    "disable"  # the browser draws; MuJoCo would load a graphics library at import
)
import mujoco  # noqa: E402 - the line above must come first

if _ASKED is None:
    del os.environ["MUJOCO_GL"]
else:
    os.environ["MUJOCO_GL"] = _ASKED

FLOOR_Z_M = -0.36
PLATE_HALF_M = (0.08, 0.08, 0.008)
SENSOR_RADIUS_M = 0.040

BLUE, STEEL, DARK = [0.10, 0.36, 0.80, 1.0], [0.72, 0.74, 0.77, 1.0], [0.17, 0.18, 0.20, 1.0]
ORANGE, GREEN = [0.93, 0.55, 0.13, 1.0], [0.20, 0.58, 0.34, 1.0]
CYLINDER, BOX = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX


class ArmModel:
    """MuJoCo model of arm, sensor and tool, and its body poses at given joint angles."""

    def __init__(self, cell: CellConfig) -> None:
        """Build the model."""
        spec = mujoco.MjSpec.from_file(str(model_file(cell.robot.model)))
        _add_tool(spec, cell)
        if cell.sim is not None:
            _add_plate(spec, cell, _tcp_at_home(cell))
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.move(np.radians(read_arm(cell.robot.model).home_deg))

    def move(self, joint_rad: Array) -> None:
        """Set the joint angles [rad]. Shape (n,)."""
        self.data.qpos[: len(joint_rad)] = joint_rad
        mujoco.mj_kinematics(self.model, self.data)


def _tcp_at_home(cell: CellConfig) -> Array:
    """Return the TCP position of the simulated arm at home, in base [m]. Shape (3,)."""
    model = mujoco.MjModel.from_xml_path(str(model_file(cell.robot.model)))
    data = mujoco.MjData(model)
    data.qpos[:] = np.radians(read_arm(cell.robot.model).home_deg)
    mujoco.mj_kinematics(model, data)
    flange = data.site("flange")
    p_flange_tcp = np.array(cell.tool.T_flange_tcp.pose.translation)
    return np.asarray(flange.xpos + flange.xmat.reshape(3, 3) @ p_flange_tcp)


def _add_tool(spec: mujoco.MjSpec, cell: CellConfig) -> None:
    """Attach sensor and tool to the flange, by the cell file's frames."""
    T_flange_sensor = cell.sensor.T_flange_sensor.pose
    T_sensor_tcp = T_flange_sensor.inverse() * cell.tool.T_flange_tcp.pose
    flange = spec.site("flange").parent
    height = max(0.012, float(T_flange_sensor.translation[2]))
    _show(flange, CYLINDER, [SENSOR_RADIUS_M, height / 2, 0], pos=[0, 0, height / 2], rgba=BLUE)
    tool = flange.add_body(name="tool", pos=T_flange_sensor.translation)
    tool.quat = _wxyz(T_flange_sensor.rotation)
    tool.mass, tool.inertia, tool.explicitinertial = 1.0, [0.01] * 3, True  # required, not used
    length = float(np.linalg.norm(T_sensor_tcp.translation))
    direction = np.asarray(T_sensor_tcp.translation) / max(length, 1e-6)
    radius = 0.025 if cell.sim is None else cell.sim.disc_radius_m
    orientation = _wxyz(_R_with_z(direction))
    rod = max(0.01, length - 0.02)
    middle = direction * (0.01 + rod / 2)
    _show(
        tool,
        CYLINDER,
        [SENSOR_RADIUS_M, 0.005, 0],
        pos=direction * 0.005,
        rgba=STEEL,
        quat=orientation,
    )
    _show(tool, CYLINDER, [0.012, rod / 2, 0], pos=middle, rgba=STEEL, quat=orientation)
    face = T_sensor_tcp.act(np.array([0.0, 0.0, -0.005]))
    _show(
        tool, CYLINDER, [radius, 0.005, 0], pos=face, rgba=ORANGE, quat=_wxyz(T_sensor_tcp.rotation)
    )


def _add_plate(spec: mujoco.MjSpec, cell: CellConfig, p_tcp_m: Array) -> None:
    """Draw the simulated plate below the tool at home, and its stand."""
    if cell.sim is None:
        return
    tilt = math.radians(cell.sim.tilt_deg)
    rim_m = cell.sim.disc_radius_m * math.tan(tilt)
    x, y, z = (float(v) for v in p_tcp_m - np.array([0.0, 0.0, cell.sim.gap_m + rim_m]))
    quat = [math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0]
    thick = PLATE_HALF_M[2]
    middle = [x, y + thick * math.sin(tilt), z - thick * math.cos(tilt)]
    world, top = spec.worldbody, z - 0.085
    _show(world, BOX, [*PLATE_HALF_M], pos=middle, rgba=GREEN, quat=quat)
    for sx in (-0.05, 0.05):
        for sy in (-0.05, 0.05):
            spring = [x + sx, y + sy, (top + z - 0.016) / 2]
            _show(world, CYLINDER, [0.009, (z - 0.016 - top) / 2, 0], pos=spring, rgba=STEEL)
    height = top - FLOOR_Z_M
    _show(world, BOX, [0.09, 0.09, 0.010], pos=[x, y, top - 0.010], rgba=DARK)
    _show(world, BOX, [0.035, 0.035, height / 2], pos=[x, y, FLOOR_Z_M + height / 2], rgba=STEEL)
    _show(world, BOX, [0.11, 0.11, 0.010], pos=[x, y, FLOOR_Z_M + 0.010], rgba=DARK)


def _show(
    body: mujoco.MjsBody,
    kind: mujoco.mjtGeom,
    size: list[float],
    *,
    pos: list[float] | Array,
    rgba: list[float],
    quat: list[float] | None = None,
) -> None:
    geom = body.add_geom(type=kind, size=size, pos=pos, rgba=rgba)
    geom.quat = quat or [1.0, 0.0, 0.0, 0.0]
    geom.contype, geom.conaffinity, geom.group = 0, 0, 1


def _R_with_z(z: Array) -> Array:
    """Return any rotation whose z axis points along a unit vector. Shape (3, 3)."""
    helper = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _wxyz(R: Array) -> list[float]:
    x, y, z, w = quaternion_from_R(R)
    return [w, x, y, z]
