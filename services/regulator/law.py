"""PI force law of the specification: wrench in, next pose out. Pure: state in, state out.

PI control in velocity form on an unrounded commanded pose x of the TCP, error e = F - F_set:

    x <- x + Kp (e - e_previous) + Ki e dt                       (force feedback position)
    R <- exp(Kpr (M - M_previous) + Kir M dt) R, base axes, about the TCP  (orientation, task c)

In mode both, the rotation is fed forward to the position so that the contact point stays in place.
Anti-windup is back-calculation: the state continues from the pose that the limits passed on
(`back_calculate`), so nothing accumulates behind a limit. The other laws add to the input of this
one: every law is `step(state, sample, settings) -> (state, motion)`, a row of `laws.py`.

Positive force is exerted by the environment on the robot; yielding means moving along it.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Literal

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array, cross, length, rotate_about_base_axes, rotation_between
from forcemesh.messages import Mode
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
            deadband_Nm=force.deadband_Nm,
            speed_max_m_s=min(force.speed_max_m_s, cell.limits.speed_m_s),
            speed_max_rad_s=force.speed_max_rad_s,
            approach_m_s=min(force.approach_m_s, cell.approach_limit_m_s, probe_m_s),
            approach_accel_m_s2=APPROACH_INERTIA_SHARE * force.touch_N / cell.contact.inertia_kg,
            touch_N=force.touch_N,
        )


@dataclass(frozen=True, slots=True)
class LawMotion:
    """Commanded pose and the last errors; None before the first sample: no proportional kick."""

    T_base_tcp: pin.SE3
    error_force_N: Array | None = None
    error_torque_Nm: Array | None = None
    contact: Contact = "free"
    approach_m_s: float = 0.0  # present speed of the approach
    speed_m_s: Array | None = None  # commanded by force control, base axes; None: none
    lever_m: Array | None = None  # from the TCP to the contact point, base axes; mode both
    follows: bool = False  # tracks a moving surface along the press axis


@dataclass(frozen=True, slots=True)
class LawInput:
    """Wrench sample and targets of one period, and the motion so far."""

    force_N: Array  # of the environment on the tool, base axes
    torque_Nm: Array  # about the TCP, base axes
    setpoint_N: float  # press along the tool's z axis
    mode: Mode
    dt_s: float  # since the last sample
    gains: PiGains
    motion: LawMotion  # so far; its pose is the last command after the arbiter's limits
    T_measured: pin.SE3  # of the TCP in base
    # Inputs from the laws around it; by default the measured error, base axes, all axes free.
    predicted_N: Array | None = None  # predicted force once all commands have arrived, base axes
    drift_m_s: Array | None = None  # feed-forward speed, base axes
    R_base_gains: Array | None = None  # axes of the force's gains
    R_base_task: Array | None = None  # task frame of `axes`
    axes: tuple[bool, ...] = ALL_AXES  # free axes of the task frame: x y z, about x y z
    pose_is_new: bool = True  # the robot has reported a pose since the last sample


def start_at(T_base_tcp: pin.SE3) -> LawMotion:
    """Return the motion that commands the present pose (bumpless start)."""
    return LawMotion(T_base_tcp.copy())


def back_calculate(motion: LawMotion, T_base_tcp: pin.SE3) -> LawMotion:
    """Return the motion that continues, from rest, at the pose that a limit passed on."""
    return replace(motion, T_base_tcp=T_base_tcp, speed_m_s=None, approach_m_s=0.0)


def next_motion(sample: LawInput, settings: LawSettings) -> LawMotion:
    """Return the motion after this sample; its pose is the next command."""
    before, gains, dt_s = sample.motion, sample.gains, sample.dt_s
    press_axis = before.T_base_tcp.rotation[:, 2]
    target_N = -sample.setpoint_N * press_axis  # the contact pushes against the press axis
    error_N = soft_deadband(sample.force_N - target_N, settings.deadband_N)
    error_Nm = soft_deadband(sample.torque_Nm, settings.deadband_Nm)
    contact, lever_m = contact_of(sample, settings.touch_N)
    turn_rad, shift_m, approach_m_s = np.zeros(3), np.zeros(3), 0.0
    speed_m_s = None
    if sample.mode != "position":
        last_Nm = error_Nm if before.error_torque_Nm is None else before.error_torque_Nm
        proportional_rad = gains.torque_p_rad_per_Nm * (error_Nm - last_Nm)
        turn_rad = proportional_rad + gains.torque_i_rad_per_Nms * error_Nm * dt_s
        turn_rad = limit_norm(masked(turn_rad, sample, 3), settings.speed_max_rad_s * dt_s)
    if sample.mode != "orientation" and contact == "approach":
        faster_m_s = before.approach_m_s + settings.approach_accel_m_s2 * dt_s
        approach_m_s = min(faster_m_s, settings.approach_m_s)
        speed_m_s = masked(approach_m_s * press_axis, sample, 0)
        shift_m = speed_m_s * dt_s
    elif sample.mode != "orientation":
        shift_m = _yielding(sample, settings, target_N=target_N, error_N=error_N)
        speed_m_s = shift_m / dt_s
        if lever_m is not None:
            shift_m = masked(shift_m - cross(turn_rad, lever_m), sample, 0)
            shift_m = limit_norm(shift_m, settings.speed_max_m_s * dt_s)
    R_base_tcp = rotate_about_base_axes(before.T_base_tcp.rotation, turn_rad)
    T_base_tcp = pin.SE3(R_base_tcp, before.T_base_tcp.translation + shift_m)
    return LawMotion(T_base_tcp, error_N, error_Nm, contact, approach_m_s, speed_m_s, lever_m)


def _yielding(sample: LawInput, settings: LawSettings, *, target_N: Array, error_N: Array) -> Array:
    """Return the shift along the free axes, limited in speed and acceleration [m]. Shape (3,)."""
    before, gains, dt_s = sample.motion, sample.gains, sample.dt_s
    predicted_N, R = error_N, sample.R_base_gains
    if sample.predicted_N is not None:
        predicted_N = soft_deadband(sample.predicted_N - target_N, settings.deadband_N)
    Ki = gains.force_i_m_per_Ns
    integral_m_s = Ki * predicted_N if R is None else R @ (Ki * (R.T @ predicted_N))
    last_N = error_N if before.error_force_N is None else before.error_force_N
    shift_m = gains.force_p_m_per_N * (error_N - last_N) + integral_m_s * dt_s
    if sample.drift_m_s is not None:
        shift_m = shift_m + sample.drift_m_s * dt_s
    shift_m = limit_norm(masked(shift_m, sample, 0), settings.speed_max_m_s * dt_s)
    speed_m_s = np.zeros(3) if before.speed_m_s is None else before.speed_m_s
    before_m = masked(speed_m_s, sample, 0) * dt_s
    return before_m + limit_norm(shift_m - before_m, settings.accel_max_m_s2 * dt_s**2)


def contact_of(sample: LawInput, touch_N: float) -> tuple[Contact, Array | None]:
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
    if -float(force_N @ before.T_base_tcp.rotation[:, 2]) > threshold_N:
        contact = "contact"
    if sample.mode != "both":
        return contact, None
    square = float(force_N @ force_N)
    if square < touch_N * touch_N:
        return contact, np.zeros(3)
    return contact, limit_norm(cross(force_N, sample.torque_Nm) / square, LONGEST_CONTACT_LEVER_M)


def motion_between(
    T_from: pin.SE3, T_to: pin.SE3, lever_m: Array | None = None
) -> tuple[Array, Array]:
    """Return travel [m] and rotation [rad] from one pose to another, base axes. Shapes (3,).

    With a lever the travel is that of the contact point, which a rotation about the TCP moves too.
    """
    moved_m = T_to.translation - T_from.translation
    turned_rad = rotation_between(T_from.rotation, T_to.rotation)
    if lever_m is not None:
        moved_m = moved_m + cross(turned_rad, lever_m)
    return moved_m, turned_rad


def masked(motion: Array, sample: LawInput, first: int) -> Array:
    """Return a motion without its parts along the locked axes of the task frame."""
    free = sample.axes[first : first + 3]
    if all(free):
        return motion
    R = np.eye(3) if sample.R_base_task is None else sample.R_base_task
    return np.asarray(R @ (np.array(free) * (R.T @ motion)))


def soft_deadband(error: Array, width: float) -> Array:
    """Shorten a vector by `width`, to zero when it is shorter: continuous, direction kept."""
    return error - limit_norm(error, width)


def limit_norm(vector: Array, longest: float) -> Array:
    """Shorten a vector to at most `longest`, direction kept."""
    size = length(vector)
    return vector if size <= longest else vector * (longest / size)
