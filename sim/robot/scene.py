"""Builds the physics of the cell: arm, sensor, off-centre disc tool and compliant plate.

The world of the model is the controller's base frame. Bodies added to the arm have explicit
inertias, and gravity is compensated everywhere, so the servos do not sag; the sensor still
feels the whole weight of the tool.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.frames import GRAVITY_M_S2, Array
from sim.robot.contact import plate_point_under
from sim.robot.decor import add_decor, draw_plate, draw_sensor, draw_tool
from sim.robot.engine import mujoco
from sim.robot.kinematics import JOINTS, MODEL_PATH, ArmKinematics
from sim.robot.settings import TICK_S, SimSettings

PLATE_THICKNESS_M = 0.016
PLATE_HALF_SIDE_M = 0.08
PLATE_TILT_DAMPING_RATIO = 1.0
RIM_POINTS = 24  # contact points on the disc's rim; one lies at the TCP frame's +x
RIM_BALL_M = 1e-5  # as good as a sharp edge: the truth about lift-off is 1 um exact
SOLREF = (0.002, 1.0)  # contact far stiffer than any plate: time constant 2 ms, damping ratio 1
SOLIMP = (0.98, 0.995, 0.001, 0.5, 2.0)


@dataclass(frozen=True, slots=True)
class Plate:
    """The plate's upper face while nothing presses on it, in base."""

    point_m: Array
    normal: Array


def home_rad(settings: SimSettings) -> Array:
    """Return the home joint angles [rad]. Shape (6,)."""
    return np.asarray(np.radians(settings.home_deg))


def plate_at_rest(settings: SimSettings) -> Plate:
    """Return where the plate lies: below the TCP's home, tilted about base x."""
    T_flange_tcp = settings.T_flange_sensor * settings.T_sensor_tcp
    T_base_tcp = ArmKinematics().flange_pose(home_rad(settings)) * T_flange_tcp
    tilt = math.radians(settings.tilt_deg)
    normal = np.array([0.0, -math.sin(tilt), math.cos(tilt)])
    point = plate_point_under(
        T_base_tcp,
        plate_normal=normal,
        disc_radius_m=settings.disc_radius_m,
        gap_m=settings.gap_m,
    )
    return Plate(point_m=point, normal=normal)


def build_spec(settings: SimSettings) -> mujoco.MjSpec:
    """Return the editable model of the whole cell."""
    spec = mujoco.MjSpec.from_file(str(MODEL_PATH))
    spec.modelname = "forcemesh cell"
    spec.option.timestep = TICK_S
    spec.option.gravity = (0.0, 0.0, -GRAVITY_M_S2)
    # A diverged simulation must be reported, not silently put back to its start.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
    plate = plate_at_rest(settings)
    add_decor(spec, plate_point_m=plate.point_m, plate_normal=plate.normal)
    _add_tool(spec, settings)
    _add_plate(spec, settings, plate)
    return spec


def build_model(settings: SimSettings) -> mujoco.MjModel:
    """Return the compiled model, its servos tuned for the load they carry.

    A critically damped servo has kp = 4 M / lag^2 and kv = kp * lag, with M the inertia that the
    joint sees at zero; so every joint follows a ramp with the same lag, whatever the tool.
    """
    model = build_spec(settings).compile()
    lag = settings.servo_lag_s
    for joint in range(JOINTS):
        kp = 4.0 * model.dof_M0[joint] / lag**2
        model.actuator_gainprm[joint, 0] = kp
        model.actuator_biasprm[joint, 1:3] = (-kp, -kp * lag)
    return model


def _add_tool(spec: mujoco.MjSpec, settings: SimSettings) -> None:
    """Hang the sensor's housing and the tool, a body of its own: the sensor sits between."""
    flange = spec.body("link6")
    T_fs, T_st = settings.T_flange_sensor, settings.T_sensor_tcp
    housing = flange.add_body(name="sensor_housing", gravcomp=1.0)
    _set_inertia(housing, settings.housing_mass_kg, T_fs.translation / 2, (0.036, 0.036, 0.03))
    draw_sensor(housing, T_fs)
    tool = flange.add_body(
        name="tool", pos=T_fs.translation, quat=_quaternion(T_fs.rotation), gravcomp=1.0
    )
    length = float(np.linalg.norm(T_st.translation))
    extent = (settings.disc_radius_m, settings.disc_radius_m, length / 2)
    _set_inertia(tool, settings.tool_mass_kg, settings.p_sensor_com_m, extent)
    draw_tool(tool, T_st, settings.disc_radius_m)
    tool.add_site(name="sensor", size=[0.004, 0.004, 0.004], rgba=[0, 0, 0, 0])
    tool.add_site(
        name="tcp",
        pos=T_st.translation,
        quat=_quaternion(T_st.rotation),
        size=[0.002, 0.002, 0.002],
        rgba=[0, 0, 0, 0],
    )
    _add_rim(tool, settings)
    for name, kind in (("force", "mjSENS_FORCE"), ("torque", "mjSENS_TORQUE")):
        spec.add_sensor(
            name=name,
            type=getattr(mujoco.mjtSensor, kind),
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname="sensor",
        )


def _add_rim(tool: mujoco.MjsBody, settings: SimSettings) -> None:
    """Put small balls on the disc's rim: ball against box is exact, cylinder against box is not.

    Their lowest points are the rim itself when the disc lies flat.
    """
    T_st = settings.T_sensor_tcp
    for k in range(RIM_POINTS):
        angle = math.tau * k / RIM_POINTS
        rim = settings.disc_radius_m * np.array([math.cos(angle), math.sin(angle), 0.0])
        tool.add_geom(
            name=f"rim{k}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[RIM_BALL_M, 0.0, 0.0],
            pos=T_st.act(rim - np.array([0.0, 0.0, RIM_BALL_M])),
            contype=1,
            conaffinity=0,
            group=4,
            rgba=[0, 0, 0, 0],
            friction=[settings.friction, 0.0, 0.0],
            solref=list(SOLREF),
            solimp=list(SOLIMP),
        )


def _add_plate(spec: mujoco.MjSpec, settings: SimSettings, plate: Plate) -> None:
    """A box on three slides and three hinges in its upper face, all with springs.

    It gives way within its plane as along its normal: a rigid grip would have friction and the
    force loop chase each other sideways, which is no property of a sprung plate.
    """
    mass, k = settings.plate_mass_kg, settings.stiffness_N_m
    k_tilt, half = settings.plate_tilt_stiffness_Nm_rad, PLATE_HALF_SIDE_M
    tilt = math.radians(settings.tilt_deg)
    body = spec.worldbody.add_body(
        name="plate",
        pos=plate.point_m,
        quat=[math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0],
        gravcomp=1.0,
    )
    extent = (half, half, PLATE_THICKNESS_M / 2)
    inertia = _set_inertia(body, mass, (0.0, 0.0, -PLATE_THICKNESS_M / 2), extent)
    for name, axis in (
        ("plate_slide_x", [1.0, 0.0, 0.0]),
        ("plate_slide_y", [0.0, 1.0, 0.0]),
        ("plate_slide", [0.0, 0.0, 1.0]),
    ):
        damping = 2.0 * settings.plate_damping_ratio * math.sqrt(k * mass)
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=axis,
            stiffness=[k, 0.0, 0.0],
            damping=[damping, 0.0, 0.0],
        )
    for name, axis in (
        ("plate_tilt_x", [1.0, 0.0, 0.0]),
        ("plate_tilt_y", [0.0, 1.0, 0.0]),
        ("plate_twist", [0.0, 0.0, 1.0]),
    ):
        damping = 2.0 * PLATE_TILT_DAMPING_RATIO * math.sqrt(k_tilt * inertia)
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=axis,
            stiffness=[k_tilt, 0.0, 0.0],
            damping=[damping, 0.0, 0.0],
        )
    body.add_geom(
        name="plate",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[half, half, PLATE_THICKNESS_M / 2],
        pos=[0.0, 0.0, -PLATE_THICKNESS_M / 2],
        contype=0,
        conaffinity=1,
        group=1,
        rgba=[0.20, 0.58, 0.34, 1.0],
        friction=[settings.friction, 0.0, 0.0],
        solref=list(SOLREF),
        solimp=list(SOLIMP),
    )
    draw_plate(body, half)


def _set_inertia(
    body: mujoco.MjsBody,
    mass_kg: float,
    com_m: Array | tuple[float, float, float],
    half_extent_m: tuple[float, float, float],
) -> float:
    """Give a body the inertia of a box about its centre; return the one about x [kg m^2]."""
    x, y, z = half_extent_m
    inertia = [mass_kg / 3 * (y * y + z * z), mass_kg / 3 * (x * x + z * z)]
    body.explicitinertial = True
    body.mass = mass_kg
    body.ipos = list(com_m)
    body.inertia = [*inertia, mass_kg / 3 * (x * x + y * y)]
    return inertia[0]


def _quaternion(R: Array) -> list[float]:
    """Return MuJoCo's quaternion (w, x, y, z)."""
    q = pin.Quaternion(R)
    return [float(q.w), float(q.x), float(q.y), float(q.z)]
