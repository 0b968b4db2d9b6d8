"""Visual geometry without collision: floor, stand, springs, tool shapes."""

import math

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from sim.robot.engine import mujoco
from sim.robot.settings import PLATE_CORNER_M

FLOOR_Z_M = -0.36  # mounting surface of the arm; the base frame is at joint 2
SENSOR_RADIUS_M = 0.040
STAND_TOP_BELOW_PLATE_M = 0.085
PLATE_THICKNESS_M = 0.016

_BLUE = [0.10, 0.36, 0.80, 1.0]
_STEEL = [0.72, 0.74, 0.77, 1.0]
_DARK = [0.17, 0.18, 0.20, 1.0]
_GREEN = [0.14, 0.45, 0.26, 1.0]
_LIGHT_GREEN = [0.20, 0.58, 0.34, 1.0]
_CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
_BOX = mujoco.mjtGeom.mjGEOM_BOX


def add_decor(spec: mujoco.MjSpec, *, plate_point_m: Array, plate_normal: Array) -> None:
    """Add sky, floor, lights and the stand below the plate."""
    _add_floor(spec)
    _add_lights(spec)
    _add_stand(spec, plate_point_m, plate_normal)


def draw_sensor(housing: mujoco.MjsBody, T_flange_sensor: pin.SE3) -> None:
    """Draw the blue sensor between flange and measuring plane."""
    height = max(0.012, float(T_flange_sensor.translation[2]))
    _show(housing, _CYLINDER, [SENSOR_RADIUS_M, height / 2, 0], pos=[0, 0, height / 2], rgba=_BLUE)
    side = [SENSOR_RADIUS_M, 0.0, height / 2]
    _show(housing, _CYLINDER, [0.010, 0.014, 0], pos=side, rgba=_DARK, euler_y=math.pi / 2)


def draw_tool(tool: mujoco.MjsBody, T_sensor_tcp: pin.SE3, disc_radius_m: float) -> None:
    """Draw the adapter, the rod and the disc whose face holds the TCP."""
    height = float(T_sensor_tcp.translation[2])
    _show(tool, _CYLINDER, [SENSOR_RADIUS_M, 0.005, 0], pos=[0, 0, 0.005], rgba=_STEEL)
    rod = max(0.01, height - 0.020)
    _show(tool, _CYLINDER, [0.012, rod / 2, 0], pos=[0, 0, 0.010 + rod / 2], rgba=_STEEL)
    # counterweight: moves the centre of mass off the axis
    _show(tool, _BOX, [0.016, 0.016, 0.018], pos=[0.022, -0.016, 0.046], rgba=_DARK)
    disc = tool.add_geom(
        type=_CYLINDER, size=[disc_radius_m, 0.005, 0], contype=0, conaffinity=0, group=1
    )
    q = pin.Quaternion(T_sensor_tcp.rotation)
    disc.pos = T_sensor_tcp.act(np.array([0.0, 0.0, -0.005]))
    disc.quat = [q.w, q.x, q.y, q.z]
    disc.rgba = [0.93, 0.55, 0.13, 1.0]


def draw_plate(plate: mujoco.MjsBody, half_side_m: float) -> None:
    """Draw the plate and the darker frame below it; the body's origin is in its upper face."""
    half = [half_side_m, half_side_m, PLATE_THICKNESS_M / 2]
    _show(plate, _BOX, half, pos=[0, 0, -PLATE_THICKNESS_M / 2], rgba=_LIGHT_GREEN)
    size = [half_side_m - 0.008, half_side_m - 0.008, 0.003]
    _show(plate, _BOX, size, pos=[0, 0, -0.019], rgba=_GREEN)


def _show(
    body: mujoco.MjsBody,
    kind: mujoco.mjtGeom,
    size: list[float],
    *,
    pos: list[float] | Array,
    rgba: list[float],
    euler_y: float = 0.0,
) -> None:
    quat = [math.cos(euler_y / 2), 0.0, math.sin(euler_y / 2), 0.0]
    geom = body.add_geom(type=kind, size=size, pos=pos, quat=quat, rgba=rgba)
    geom.contype, geom.conaffinity, geom.group = 0, 0, 1


def _add_floor(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.98, 0.985, 0.99],
        rgb2=[0.80, 0.85, 0.90],
        width=256,
        height=256,
    )
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.86, 0.87, 0.89],
        rgb2=[0.80, 0.82, 0.84],
        width=256,
        height=256,
    )
    floor = spec.add_material(name="floor", texrepeat=[4, 4], texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[4.0, 4.0, 0.05],
        pos=[0.0, 0.0, FLOOR_Z_M],
        material="floor",
        contype=0,
        conaffinity=0,
        group=1,
    )


def _add_lights(spec: mujoco.MjSpec) -> None:
    spec.visual.headlight.ambient = [0.34, 0.34, 0.34]
    spec.visual.headlight.diffuse = [0.20, 0.20, 0.20]
    spec.visual.headlight.specular = [0.05, 0.05, 0.05]
    spec.visual.quality.shadowsize = 4096
    for pos, strength, shadow in (([1.4, 1.2, 2.4], 0.55, True), ([-1.5, 0.4, 1.8], 0.18, False)):
        spec.worldbody.add_light(
            pos=pos,
            dir=[-pos[0], 0.3 - pos[1], -pos[2]],
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            diffuse=[strength] * 3,
            specular=[0.12] * 3,
            castshadow=shadow,
        )


def _add_stand(spec: mujoco.MjSpec, plate_point_m: Array, plate_normal: Array) -> None:
    """Add a column on the floor, a level table, and four springs to the plate's corners."""
    x, y, z = (float(value) for value in plate_point_m)
    top = z - STAND_TOP_BELOW_PLATE_M
    world, height = spec.worldbody, top - 0.02 - FLOOR_Z_M
    _show(world, _BOX, [0.11, 0.11, 0.010], pos=[x, y, FLOOR_Z_M + 0.010], rgba=_DARK)
    _show(world, _BOX, [0.035, 0.035, height / 2], pos=[x, y, FLOOR_Z_M + height / 2], rgba=_STEEL)
    _show(world, _BOX, [0.09, 0.09, 0.010], pos=[x, y, top - 0.010], rgba=_DARK)
    for sx in (-1.0, 1.0):
        for sy in (-1.0, 1.0):
            dx, dy = sx * PLATE_CORNER_M, sy * PLATE_CORNER_M
            rise = -(plate_normal[0] * dx + plate_normal[1] * dy) / plate_normal[2]
            _add_spring(spec, [x + dx, y + dy], bottom_m=top, top_m=z + float(rise) - 0.02)


def _add_spring(spec: mujoco.MjSpec, corner: list[float], *, bottom_m: float, top_m: float) -> None:
    rings = 7
    for k in range(rings):
        z = bottom_m + (k + 0.5) * (top_m - bottom_m) / rings
        _show(spec.worldbody, _CYLINDER, [0.011, 0.0022, 0], pos=[*corner, z], rgba=_STEEL)
    middle = (bottom_m + top_m) / 2
    _show(
        spec.worldbody,
        _CYLINDER,
        [0.006, (top_m - bottom_m) / 2, 0],
        pos=[*corner, middle],
        rgba=_DARK,
    )
