"""MuJoCo model of the cell: arm, sensor, off-centre disc tool; plate, stand and floor to see.

The world frame of the model is the controller's base frame. Bodies added to the arm have explicit
inertias. Gravity is compensated on all bodies, so the servos have no static error; the sensor
still measures the whole weight of the tool.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.config.arm import model_file
from common.motion.frames import GRAVITY_M_S2, Array, scaled
from common.motion.kinematics import ArmKinematics
from sim.robot.engine import mujoco
from sim.robot.plate import HALF_SIDE_M, plate_point_under
from sim.robot.settings import HOUSING_MASS_KG, PLATE_CORNER_M, TICK_S, SimSettings

FLOOR_Z_M = -0.36  # mounting surface of the arm; the base frame is at joint 2
SENSOR_RADIUS_M = 0.040
STAND_TOP_BELOW_PLATE_M = 0.085
PLATE_THICKNESS_M = 0.016
# Three numbers each, in the order of `sensordata`.
SENSORS = (
    ("force", "sensor"),
    ("torque", "sensor"),
    ("framepos", "tcp"),
    ("framezaxis", "tcp"),
    ("framelinvel", "tcp"),
    ("frameangvel", "tcp"),
)
_RINGS = 7  # of a spring

_BLUE = [0.10, 0.36, 0.80, 1.0]
_STEEL = [0.72, 0.74, 0.77, 1.0]
_DARK = [0.17, 0.18, 0.20, 1.0]
_GREEN = [0.14, 0.45, 0.26, 1.0]
_LIGHT_GREEN = [0.20, 0.58, 0.34, 1.0]
_ORANGE = [0.93, 0.55, 0.13, 1.0]
_UPRIGHT = np.eye(3)
_CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
_BOX = mujoco.mjtGeom.mjGEOM_BOX


@dataclass(frozen=True, slots=True)
class Plate:
    """Upper face of the undeflected plate, in base."""

    point_m: Array
    R_base_plate: Array

    @property
    def normal(self) -> Array:
        """Unit normal of the face, upwards. Shape (3,)."""
        return self.R_base_plate[:, 2]


def plate_at_rest(settings: SimSettings) -> Plate:
    """Return the undeflected plate: below the TCP at home, tilted about base x."""
    T_base_tcp = ArmKinematics(settings.arm).flange_pose(settings.home_rad) * settings.T_flange_tcp
    R_base_plate = pin.utils.rotate("x", math.radians(settings.tilt_deg))
    point = plate_point_under(
        T_base_tcp,
        plate_normal=R_base_plate[:, 2],
        disc_radius_m=settings.disc_radius_m,
        gap_m=settings.gap_m,
    )
    return Plate(point_m=point, R_base_plate=R_base_plate)


def build_spec(settings: SimSettings, *, pushed_m: float = 0.0) -> mujoco.MjSpec:
    """Return the editable model of the whole cell, the plate drawn deflected by `pushed_m`."""
    spec = mujoco.MjSpec.from_file(str(model_file(settings.arm)))
    spec.modelname = "forcemesh cell"
    spec.option.timestep = TICK_S
    spec.option.gravity = scaled(settings.gravity_direction_in_base, GRAVITY_M_S2)
    # A diverged simulation must be reported, not silently reset.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
    plate = plate_at_rest(settings)
    _add_floor(spec)
    _add_lights(spec)
    _add_stand(spec, plate.point_m, plate.normal)
    _add_tool(spec, settings)
    if settings.surface == "plane":
        _add_plate(spec, plate, pushed_m)
    else:
        _add_curved(spec, plate, settings)
    return spec


def build_model(settings: SimSettings) -> mujoco.MjModel:
    """Return the compiled model, its servos tuned for their load.

    A critically damped servo has kp = 4 M / lag^2 and kv = kp * lag, with M the inertia that the
    joint has at zero; every joint then follows a ramp with the same lag, for any tool.
    """
    model = build_spec(settings).compile()
    lag = settings.servo_lag_s
    for joint in range(model.nu):
        kp = 4.0 * model.dof_M0[joint] / lag**2
        model.actuator_gainprm[joint, 0] = kp
        model.actuator_biasprm[joint, 1:3] = (-kp, -kp * lag)
    return model


def _add_tool(spec: mujoco.MjSpec, settings: SimSettings) -> None:
    """Add the sensor housing and the tool as separate bodies, with the sensor between them."""
    flange = spec.site("flange").parent
    T_fs, T_st = settings.T_flange_sensor, settings.T_sensor_tcp
    housing = flange.add_body(name="sensor_housing", gravcomp=1.0)
    _set_inertia(housing, HOUSING_MASS_KG, T_fs.translation / 2, (0.036, 0.036, 0.03))
    _draw_sensor(housing, T_fs)
    tool = flange.add_body(
        name="tool", pos=T_fs.translation, quat=_quaternion(T_fs.rotation), gravcomp=1.0
    )
    length = float(np.linalg.norm(T_st.translation))
    extent = (settings.disc_radius_m, settings.disc_radius_m, length / 2)
    _set_inertia(tool, settings.tool_mass_kg, settings.tool_com_m, extent)
    _draw_tool(tool, T_st, settings.disc_radius_m)
    tool.add_site(name="sensor", size=[0.004, 0.004, 0.004], rgba=[0, 0, 0, 0])
    tool.add_site(
        name="tcp",
        pos=T_st.translation,
        quat=_quaternion(T_st.rotation),
        size=[0.002, 0.002, 0.002],
        rgba=[0, 0, 0, 0],
    )
    # Massless: a force on it acts on the tool, about the TCP.
    disc = tool.add_body(name="disc", pos=T_st.translation, explicitinertial=True, mass=0.0)
    disc.ipos = [0.0, 0.0, 0.0]
    for kind, site in SENSORS:
        spec.add_sensor(
            name=f"{site}_{kind}",
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}"),
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=site,
        )


def _add_plate(spec: mujoco.MjSpec, plate: Plate, pushed_m: float) -> None:
    """Draw the plate and the darker frame below it; the body's origin is in its upper face.

    Its contact model is in sim.robot.plate, outside MuJoCo.
    """
    body = spec.worldbody.add_body(
        name="plate",
        pos=plate.point_m - pushed_m * plate.normal,
        quat=_quaternion(plate.R_base_plate),
    )
    half = [HALF_SIDE_M, HALF_SIDE_M, PLATE_THICKNESS_M / 2]
    _show(body, _BOX, half, pos=[0, 0, -PLATE_THICKNESS_M / 2], rgba=_LIGHT_GREEN)
    size = [HALF_SIDE_M - 0.008, HALF_SIDE_M - 0.008, 0.003]
    _show(body, _BOX, size, pos=[0, 0, -0.019], rgba=_GREEN)


def _add_curved(spec: mujoco.MjSpec, plate: Plate, settings: SimSettings) -> None:
    """Draw a curved surface in place of the plate; its contact model is in sim.robot.curved."""
    spec.add_mesh(name="curved", uservert=np.ravel(settings.curved_points_m()))
    body = spec.worldbody.add_body(
        name="plate", pos=plate.point_m, quat=_quaternion(plate.R_base_plate)
    )
    geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="curved", rgba=_LIGHT_GREEN)
    geom.contype, geom.conaffinity, geom.group = 0, 0, 1


def _set_inertia(
    body: mujoco.MjsBody,
    mass_kg: float,
    com_m: Array | tuple[float, float, float],
    half_extent_m: tuple[float, float, float],
) -> None:
    """Give a body the inertia of a box about its centre."""
    x, y, z = half_extent_m
    inertia = [mass_kg / 3 * (y * y + z * z), mass_kg / 3 * (x * x + z * z)]
    body.explicitinertial = True
    body.mass = mass_kg
    body.ipos = list(com_m)
    body.inertia = [*inertia, mass_kg / 3 * (x * x + y * y)]


def _quaternion(R: Array) -> list[float]:
    """Return MuJoCo's quaternion (w, x, y, z)."""
    q = pin.Quaternion(R)
    return [float(q.w), float(q.x), float(q.y), float(q.z)]


# --- visual geometry without collision ------------------------------------------------------------


def _draw_sensor(housing: mujoco.MjsBody, T_flange_sensor: pin.SE3) -> None:
    """Draw the blue sensor between flange and measuring plane."""
    height = max(0.012, float(T_flange_sensor.translation[2]))
    _show(housing, _CYLINDER, [SENSOR_RADIUS_M, height / 2, 0], pos=[0, 0, height / 2], rgba=_BLUE)
    side = [SENSOR_RADIUS_M, 0.0, height / 2]
    sideways = pin.utils.rotate("y", math.pi / 2)
    _show(housing, _CYLINDER, [0.010, 0.014, 0], pos=side, rgba=_DARK, R=sideways)


def _draw_tool(tool: mujoco.MjsBody, T_sensor_tcp: pin.SE3, disc_radius_m: float) -> None:
    """Draw the adapter, the rod and the disc whose face holds the TCP."""
    height = float(T_sensor_tcp.translation[2])
    _show(tool, _CYLINDER, [SENSOR_RADIUS_M, 0.005, 0], pos=[0, 0, 0.005], rgba=_STEEL)
    rod = max(0.01, height - 0.020)
    _show(tool, _CYLINDER, [0.012, rod / 2, 0], pos=[0, 0, 0.010 + rod / 2], rgba=_STEEL)
    # counterweight: moves the centre of mass off the axis
    _show(tool, _BOX, [0.016, 0.016, 0.018], pos=[0.022, -0.016, 0.046], rgba=_DARK)
    size, pos = [disc_radius_m, 0.005, 0], T_sensor_tcp.act(np.array([0.0, 0.0, -0.005]))
    _show(tool, _CYLINDER, size, pos=pos, rgba=_ORANGE, R=T_sensor_tcp.rotation)


def _show(
    body: mujoco.MjsBody,
    kind: mujoco.mjtGeom,
    size: list[float],
    *,
    pos: list[float] | Array,
    rgba: list[float],
    R: Array = _UPRIGHT,
) -> None:
    geom = body.add_geom(type=kind, size=size, pos=pos, quat=_quaternion(R), rgba=rgba)
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
            corner, length = [x + dx, y + dy], z + float(rise) - 0.02 - top
            for ring in range(_RINGS):
                pos = [*corner, top + (ring + 0.5) * length / _RINGS]
                _show(world, _CYLINDER, [0.011, 0.0022, 0], pos=pos, rgba=_STEEL)
            size, pos = [0.006, length / 2, 0], [*corner, top + length / 2]
            _show(world, _CYLINDER, size, pos=pos, rgba=_DARK)
