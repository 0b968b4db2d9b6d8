"""The specification's PI regulator: wrench in, next pose out. Pure: state in, state out.

Velocity form on an unrounded commanded pose x of the TCP, error e = F - F_set:

    x <- x + Kp (e - e_previous) + Ki e dt                       (force feedback position)
    R <- exp(Kpr (M - M_previous) + Kir M dt) R, base axes, about the TCP  (orientation, task c)

In mode both, the turning is fed forward to the position so that the point of contact stays.

Positive force is what the environment does to the robot, so giving way means moving along it.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Literal

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, cross, length, rotate_about_base_axes
from forcemesh.messages import Mode

Contact = Literal["free", "approach", "contact"]
RELEASE_FRACTION = 0.5  # contact ends below this part of the touch force
LONGEST_LEVER_M = 0.1  # a contact farther from the TCP than this is taken for noise
ALL_AXES = (True,) * 6


@dataclass(frozen=True, slots=True)
class LawSettings:
    """Everything but the gains that shapes the law."""

    deadband_N: float
    deadband_Nm: float
    speed_max_m_s: float
    speed_max_rad_s: float
    approach_m_s: float
    approach_accel_m_s2: float  # so gentle that the tool's inertia is not taken for contact
    touch_N: float
    accel_max_m_s2: float = inf  # of a law that foresees what its own commands will do


@dataclass(frozen=True, slots=True)
class PiGains:
    """Gains about the base axes x, y, z; each of shape (3,)."""

    force_p_m_per_N: Array
    force_i_m_per_Ns: Array
    torque_p_rad_per_Nm: Array
    torque_i_rad_per_Nms: Array


@dataclass(frozen=True, slots=True)
class LawInput:
    """One wrench sample and what is wanted."""

    force_N: Array  # of the environment on the tool, base axes
    torque_Nm: Array  # about the TCP, base axes
    setpoint_N: float  # press along the tool's z axis
    mode: Mode
    dt_s: float  # since the last sample
    # What a richer law adds; without it the error is what is measured, in base axes, all free.
    foreseen_N: Array | None = None  # force once all commands have arrived, base axes
    drift_m_s: Array | None = None  # of what is pressed on, base axes
    R_base_gains: Array | None = None  # axes of the force's gains
    R_base_task: Array | None = None  # axes of the mask
    axes: tuple[bool, ...] = ALL_AXES  # of the task frame that may move: x y z, about x y z
    pose_is_new: bool = True  # the robot has said a pose since the last sample


@dataclass(frozen=True, slots=True)
class LawState:
    """Commanded pose and the last errors; None before the first sample: no proportional kick."""

    T_base_tcp: pin.SE3
    error_force_N: Array | None = None
    error_torque_Nm: Array | None = None
    contact: Contact = "free"
    approach_m_s: float = 0.0  # speed of the approach under way
    speed_m_s: Array | None = None  # with which it gives way or presses, base axes; None: none
    lever_m: Array | None = None  # from the TCP to the point of contact, base axes; mode both


def start_at(T_base_tcp: pin.SE3) -> LawState:
    """Return the state that commands the pose where the tool is: no bump."""
    return LawState(T_base_tcp.copy())


def put_back(state: LawState, T_base_tcp: pin.SE3) -> LawState:
    """Return the state that goes on, from rest, where a limit has let the tool come to."""
    return replace(state, T_base_tcp=T_base_tcp, speed_m_s=None, approach_m_s=0.0)


def step(state: LawState, sample: LawInput, gains: PiGains, settings: LawSettings) -> LawState:
    """Return the next state; its pose is the next command."""
    press_axis = state.T_base_tcp.rotation[:, 2]
    wanted_force_N = -sample.setpoint_N * press_axis  # pressing down is being pushed up
    error_N = soft_deadband(sample.force_N - wanted_force_N, settings.deadband_N)
    error_Nm = soft_deadband(sample.torque_Nm, settings.deadband_Nm)
    contact = next_contact(state.contact, sample, press_axis, settings.touch_N)
    lever_m = contact_point(sample, settings.touch_N) if sample.mode == "both" else None
    turn_rad, shift_m, approach_m_s = np.zeros(3), np.zeros(3), 0.0
    speed_m_s = None
    if sample.mode != "position":
        proportional_rad = gains.torque_p_rad_per_Nm * change(error_Nm, state.error_torque_Nm)
        turn_rad = proportional_rad + gains.torque_i_rad_per_Nms * error_Nm * sample.dt_s
        turn_rad = limit_norm(_masked(turn_rad, sample, 3), settings.speed_max_rad_s * sample.dt_s)
    if sample.mode != "orientation" and contact == "approach":
        faster_m_s = state.approach_m_s + settings.approach_accel_m_s2 * sample.dt_s
        approach_m_s = min(faster_m_s, settings.approach_m_s)
        speed_m_s = _masked(approach_m_s * press_axis, sample, 0)
        shift_m = speed_m_s * sample.dt_s
    elif sample.mode != "orientation":
        foreseen_N = error_N
        if sample.foreseen_N is not None:
            foreseen_N = soft_deadband(sample.foreseen_N - wanted_force_N, settings.deadband_N)
        gain = gains.force_i_m_per_Ns
        integral_m = _along(gain, foreseen_N, sample.R_base_gains) * sample.dt_s
        proportional_m = gains.force_p_m_per_N * change(error_N, state.error_force_N)
        shift_m = proportional_m + integral_m
        if sample.drift_m_s is not None:
            shift_m = shift_m + sample.drift_m_s * sample.dt_s
        shift_m = _sped_up(state.speed_m_s, shift_m, sample, settings)
        speed_m_s = shift_m / sample.dt_s
        if lever_m is not None:
            shift_m = _masked(shift_m - cross(turn_rad, lever_m), sample, 0)
            shift_m = limit_norm(shift_m, settings.speed_max_m_s * sample.dt_s)
    R_base_tcp = rotate_about_base_axes(state.T_base_tcp.rotation, turn_rad)
    T_base_tcp = pin.SE3(R_base_tcp, state.T_base_tcp.translation + shift_m)
    return LawState(T_base_tcp, error_N, error_Nm, contact, approach_m_s, speed_m_s, lever_m)


def next_contact(contact: Contact, sample: LawInput, press_axis: Array, touch_N: float) -> Contact:
    """Tell whether the tool touches, with hysteresis, or still seeks what it shall press on."""
    pushed_back_N = -float(sample.force_N @ press_axis)
    touch_N = min(touch_N, 0.5 * sample.setpoint_N) if sample.setpoint_N > 0.0 else touch_N
    threshold_N = touch_N * (RELEASE_FRACTION if contact == "contact" else 1.0)
    if pushed_back_N > threshold_N:
        return "contact"
    return "approach" if sample.setpoint_N > 0.0 else "free"


def contact_point(sample: LawInput, touch_N: float) -> Array:
    """Return the vector from the TCP to the line along which the force acts [m]. Shape (3,).

    r = F x M / |F|^2. Turning about the TCP moves the point of contact by turn x r; taking that
    back keeps the force while the tool turns, instead of leaving it to the force loop's delay.
    """
    square = float(sample.force_N @ sample.force_N)
    if square < touch_N * touch_N:
        return np.zeros(3)
    lever_m = cross(sample.force_N, sample.torque_Nm) / square
    return limit_norm(lever_m, LONGEST_LEVER_M)


def _sped_up(
    before_m_s: Array | None, shift_m: Array, sample: LawInput, settings: LawSettings
) -> Array:
    """Return a shift that speed and acceleration allow, along the axes that may move."""
    shift_m = limit_norm(_masked(shift_m, sample, 0), settings.speed_max_m_s * sample.dt_s)
    before_m = np.zeros(3) if before_m_s is None else _masked(before_m_s, sample, 0) * sample.dt_s
    most_m = settings.accel_max_m_s2 * sample.dt_s**2
    return before_m + limit_norm(shift_m - before_m, most_m)


def _along(gain: Array, error: Array, R: Array | None) -> Array:
    """Return gain times error, about the axes of R_base_gains."""
    return gain * error if R is None else np.asarray(R @ (gain * (R.T @ error)))


def _masked(motion: Array, sample: LawInput, first: int) -> Array:
    """Return a motion without the axes of the task frame that may not move."""
    free = sample.axes[first : first + 3]
    if all(free):
        return motion
    R = np.eye(3) if sample.R_base_task is None else sample.R_base_task
    return np.asarray(R @ (np.array(free) * (R.T @ motion)))


def change(now: Array, before: Array | None) -> Array:
    """Return the change since the last sample, none at the first one."""
    return np.zeros(3) if before is None else now - before


def soft_deadband(error: Array, width: float) -> Array:
    """Shorten a vector by `width`, to zero when it is shorter: continuous, direction kept."""
    size = length(error)
    if size <= width:
        return np.zeros(3)
    return error * ((size - width) / size)


def limit_norm(vector: Array, longest: float) -> Array:
    """Shorten a vector to at most `longest`, direction kept."""
    size = length(vector)
    return vector if size <= longest else vector * (longest / size)
