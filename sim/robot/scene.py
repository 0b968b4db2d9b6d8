"""MuJoCo model of the cell: arm, sensor, off-centre disc tool, and the visual plate.

The world frame of the model is the controller's base frame. Bodies added to the arm have explicit
inertias. Gravity is compensated on all bodies, so the servos have no static error; the sensor
still measures the whole weight of the tool.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.config.arm import model_file
from common.motion.frames import GRAVITY_M_S2, Array
from common.motion.kinematics import ArmKinematics
from sim.robot.decor import add_decor, draw_plate, draw_sensor, draw_tool
from sim.robot.engine import mujoco
from sim.robot.plate import HALF_SIDE_M, plate_point_under
from sim.robot.settings import HOUSING_MASS_KG, TICK_S, SimSettings


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
    spec.option.gravity = (0.0, 0.0, -GRAVITY_M_S2)
    # A diverged simulation must be reported, not silently reset.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
    plate = plate_at_rest(settings)
    add_decor(spec, plate_point_m=plate.point_m, plate_normal=plate.normal)
    _add_tool(spec, settings)
    _add_plate(spec, plate, pushed_m)
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
    draw_sensor(housing, T_fs)
    tool = flange.add_body(
        name="tool", pos=T_fs.translation, quat=_quaternion(T_fs.rotation), gravcomp=1.0
    )
    length = float(np.linalg.norm(T_st.translation))
    extent = (settings.disc_radius_m, settings.disc_radius_m, length / 2)
    _set_inertia(tool, settings.tool_mass_kg, settings.tool_com_m, extent)
    draw_tool(tool, T_st, settings.disc_radius_m)
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
    for name, kind in (("force", "mjSENS_FORCE"), ("torque", "mjSENS_TORQUE")):
        spec.add_sensor(
            name=name,
            type=getattr(mujoco.mjtSensor, kind),
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname="sensor",
        )


def _add_plate(spec: mujoco.MjSpec, plate: Plate, pushed_m: float) -> None:
    """Draw the plate. Its contact model is in sim.robot.plate, outside MuJoCo."""
    body = spec.worldbody.add_body(
        name="plate",
        pos=plate.point_m - pushed_m * plate.normal,
        quat=_quaternion(plate.R_base_plate),
    )
    draw_plate(body, HALF_SIDE_M)


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
