"""PI force law of the specification: wrench in, next pose out. Pure: state in, state out.

PI control in velocity form on an unrounded commanded pose x of the TCP, error e = F - F_set:

    x <- x + Kp (e - e_previous) + Ki e dt                       (force feedback position)
    R <- exp(Kpr (M - M_previous) + Kir M dt) R, base axes, about the TCP  (orientation, task c)

In mode both, the rotation is fed forward to the position so that the contact point stays in place.
Anti-windup is back-calculation: the state continues from the pose that the limits passed on
(`back_calculate`), so nothing accumulates behind a limit. The other laws replace the speed of its
integral part: every law is `step(state, sample, settings) -> (state, motion)`, a row of `laws.py`.

Positive force is exerted by the environment on the robot; yielding means moving along it.
"""

from dataclasses import dataclass, field, replace
from math import hypot, inf
from typing import Literal

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import (
    Rows,
    Vector,
    cross,
    dot,
    moved,
    plus,
    product,
    rotated,
    rotated_back,
    scaled,
    speeds_between,
)
from forcemesh.messages import ZERO3, Mode, Vec3
from services.regulator.gains import PiGains

Contact = Literal["free", "approach", "contact"]
RELEASE_FRACTION = 0.5  # contact ends below this share of the touch force
LONGEST_CONTACT_LEVER_M = 0.1  # a contact farther from the TCP is treated as noise
ALL_AXES = (True,) * 6
PROBE_N = 5.0  # overshoot of the first touch, which verifies the signs and must stay gentle
APPROACH_INERTIA_SHARE = 0.1  # largest inertial force of the approach, relative to the touch force


@dataclass(frozen=True, slots=True)
class LawSettings:
    """Parameters of the law besides the gains."""

    deadband_N: float
    deadband_Nm: float
    speed_max_m_s: float
    speed_max_rad_s: float
    approach_m_s: float
    approach_accel_m_s2: float  # low enough that the tool's inertia does not look like contact
    touch_N: float
    rest_N: float = 0.0  # a smaller error is rounding of the set point: it would never come to rest
    accel_max_m_s2: float = inf  # finite for a law with a predictor

    @classmethod
    def of(cls, cell: CellConfig) -> "LawSettings":
        """Return the settings of a cell; the approach speed follows from its force budget.

        The first touch adds about k v tau before the loop reacts.
        """
        force = cell.force
        probe_m_s = PROBE_N / (cell.contact.stiffness_N_m * cell.loop_delay_s)
        return cls(
            deadband_N=force.deadband_N,
            rest_N=cell.setpoint_rounding_m * cell.contact.stiffness_N_m,
            deadband_Nm=force.deadband_Nm,
            speed_max_m_s=min(force.speed_max_m_s, cell.limits.speed_m_s),
            speed_max_rad_s=force.speed_max_rad_s,
            approach_m_s=min(force.approach_m_s, cell.approach_limit_m_s, probe_m_s),
            approach_accel_m_s2=APPROACH_INERTIA_SHARE * force.touch_N / cell.contact.inertia_kg,
            touch_N=force.touch_N,
        )


@dataclass(slots=True)
class LawMotion:
    """Commanded pose and the last errors; None before the first sample: no proportional kick."""

    T_base_tcp: pin.SE3
    error_force_N: Vec3 | None = None
    error_torque_Nm: Vec3 | None = None
    contact: Contact = "free"
    approach_m_s: float = 0.0  # present speed of the approach
    speed_m_s: Vec3 = ZERO3  # commanded by force control, base axes
    lever_m: Vector | None = None  # from the TCP to the contact point, base axes; mode both
    follows: bool = False  # tracks a moving surface along the press axis


@dataclass(slots=True)
class LawInput:
    """Wrench sample and targets of one period, and the motion so far."""

    force_N: Vec3  # of the environment on the tool, base axes
    torque_Nm: Vec3  # about the TCP, base axes
    setpoint_N: float  # press along the tool's z axis
    mode: Mode
    dt_s: float  # since the last sample
    gains: PiGains
    motion: LawMotion  # so far; its pose is the last command after the arbiter's limits
    T_measured: pin.SE3  # of the TCP in base
    frame: Literal["base", "tool"] = "base"  # task frame of `axes`
    axes: tuple[bool, ...] = ALL_AXES  # free axes of the task frame: x y z, about x y z
    pose_is_new: bool = True  # the robot has reported a pose since the last sample
    R_base_tcp: Rows = field(init=False)  # of the motion so far
    press_axis: Vec3 = field(init=False)  # the tool's z axis, base axes

    def __post_init__(self) -> None:
        """Convert the orientation once for all that use it."""
        x, y, z = self.R_base_tcp = self.motion.T_base_tcp.rotation.tolist()
        self.press_axis = (x[2], y[2], z[2])


def start_at(T_base_tcp: pin.SE3) -> LawMotion:
    """Return the motion that commands the present pose (bumpless start)."""
    return LawMotion(T_base_tcp.copy())


def back_calculate(motion: LawMotion, T_base_tcp: pin.SE3) -> LawMotion:
    """Return the motion that continues, from rest, at the pose that a limit passed on."""
    return replace(motion, T_base_tcp=T_base_tcp, speed_m_s=ZERO3, approach_m_s=0.0)


def next_motion(
    sample: LawInput, settings: LawSettings, integral_m_s: Vec3 | None = None
) -> LawMotion:
    """Return the motion after this sample; its pose is the next command.

    A law around this one gives `integral_m_s` [m/s] in place of Ki e, base axes.
    """
    before, gains, dt_s = sample.motion, sample.gains, sample.dt_s
    press_axis = sample.press_axis
    # The contact pushes against the press axis.
    error_N = plus(sample.force_N, press_axis, sample.setpoint_N)
    error_N = soft_deadband(error_N, settings.deadband_N, settings.rest_N)
    error_Nm = soft_deadband(sample.torque_Nm, settings.deadband_Nm)
    contact, lever_m = contact_of(sample, settings.touch_N)
    turn_rad = shift_m = speed_m_s = ZERO3
    approach_m_s = 0.0
    if sample.mode != "position":
        change_Nm = plus(error_Nm, before.error_torque_Nm or error_Nm, -1.0)
        step_rad = product(gains.torque_p_rad_per_Nm, change_Nm)
        step_rad = plus(step_rad, product(gains.torque_i_rad_per_Nms, error_Nm), dt_s)
        turn_rad = limit_norm(masked(step_rad, sample, 3), settings.speed_max_rad_s * dt_s)
    if sample.mode != "orientation" and contact == "approach":
        faster_m_s = before.approach_m_s + settings.approach_accel_m_s2 * dt_s
        approach_m_s = min(faster_m_s, settings.approach_m_s)
        speed_m_s = masked(scaled(press_axis, approach_m_s), sample, 0)
        shift_m = scaled(speed_m_s, dt_s)
    elif sample.mode != "orientation":
        shift_m = _yielding(sample, settings, error_N, integral_m_s)
        speed_m_s = scaled(shift_m, 1.0 / dt_s)
        if lever_m is not None:
            shift_m = plus(shift_m, cross(turn_rad, lever_m), -1.0)
            shift_m = limit_norm(masked(shift_m, sample, 0), settings.speed_max_m_s * dt_s)
    T_base_tcp = moved(before.T_base_tcp, (shift_m, turn_rad), 1.0)
    return LawMotion(T_base_tcp, error_N, error_Nm, contact, approach_m_s, speed_m_s, lever_m)


def _yielding(
    sample: LawInput, settings: LawSettings, error_N: Vec3, integral_m_s: Vec3 | None
) -> Vec3:
    """Return the shift along the free axes, limited in speed and acceleration [m]. Shape (3,)."""
    before, gains, dt_s = sample.motion, sample.gains, sample.dt_s
    change_N = plus(error_N, before.error_force_N or error_N, -1.0)
    step_m = product(gains.force_p_m_per_N, change_N)
    step_m = plus(step_m, integral_m_s or product(gains.force_i_m_per_Ns, error_N), dt_s)
    shift_m = limit_norm(masked(step_m, sample, 0), settings.speed_max_m_s * dt_s)
    if settings.accel_max_m_s2 == inf:
        return shift_m
    before_m = scaled(masked(before.speed_m_s, sample, 0), dt_s)
    change_m = limit_norm(plus(shift_m, before_m, -1.0), settings.accel_max_m_s2 * dt_s**2)
    return plus(before_m, change_m)


def contact_of(sample: LawInput, touch_N: float) -> tuple[Contact, Vector | None]:
    """Return the contact state and, in mode both, the vector from the TCP to the contact [m].

    The state is a force threshold with hysteresis, below it approach or free. The vector ends at
    the line along which the force acts: r = F x M / |F|^2. Shape (3,). A rotation about the TCP
    moves the contact point by turn x r; compensating that motion keeps the force constant, without
    waiting for the force loop and its delay.
    """
    force_N, before, presses = sample.force_N, sample.motion, sample.setpoint_N > 0.0
    threshold_N = min(touch_N, 0.5 * sample.setpoint_N) if presses else touch_N
    if before.contact == "contact":
        threshold_N *= RELEASE_FRACTION
    contact: Contact = "approach" if presses else "free"
    if -dot(force_N, sample.press_axis) > threshold_N:
        contact = "contact"
    if sample.mode != "both":
        return contact, None
    square = dot(force_N, force_N)
    if square < touch_N * touch_N:
        return contact, ZERO3
    lever_m = scaled(cross(force_N, sample.torque_Nm), 1.0 / square)
    return contact, limit_norm(lever_m, LONGEST_CONTACT_LEVER_M)


def motion_between(
    T_from: pin.SE3, T_to: pin.SE3, lever_m: Vector | None = None
) -> tuple[Vec3, Vec3]:
    """Return travel [m] and rotation [rad] from one pose to another, base axes. Shapes (3,).

    With a lever the travel is that of the contact point, which a rotation about the TCP moves too.
    """
    moved_m, turned_rad = speeds_between(T_from, T_to, 1.0)
    if lever_m is not None:
        moved_m = plus(moved_m, cross(turned_rad, lever_m))
    return moved_m, turned_rad


def masked(motion: Vec3, sample: LawInput, first: int) -> Vec3:
    """Return a motion without its parts along the locked axes of the task frame."""
    free = sample.axes[first : first + 3]
    if all(free):
        return motion
    if sample.frame == "base":
        return product(motion, free)
    R_base_tcp = sample.R_base_tcp
    return rotated(R_base_tcp, product(rotated_back(R_base_tcp, motion), free))


def soft_deadband(error: Vector, width: float, rest: float = 0.0) -> Vec3:
    """Shorten a vector by `width`, to zero when it is shorter: continuous, direction kept.

    A vector shorter than `rest` is zero as well, with a step at that length.
    """
    size = hypot(*error)
    return scaled(error, 1.0 - width / size) if size > max(width, rest) else ZERO3


def limit_norm(vector: Vec3, longest: float) -> Vec3:
    """Shorten a vector to at most `longest`, direction kept."""
    size = hypot(*vector)
    return vector if size <= longest else scaled(vector, longest / size)
