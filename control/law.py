"""PI force law of the specification: wrench in, next pose out. Pure: state in, state out.

PI control in velocity form on an unrounded commanded pose x of the TCP, error e = F - F_set:

    x <- x + Kp (e - e_previous) + Ki e dt                       (force feedback position)
    R <- exp(Kpr (M - M_previous) + Kir M dt) R, base axes, about the TCP  (orientation, task c)

It knows no limits: what it wants becomes the command in `shape.py`. Anti-windup is
back-calculation: the state continues from the pose that the limits passed on, there and in the
arbiter (`back_calculate`), so nothing accumulates behind a limit. The other laws replace the speed
of its integral part: every law is `step(state, sample, settings) -> (state, motion)`, a row of
`laws.py`.

Positive force is exerted by the environment on the robot; yielding means moving along it.
"""

from dataclasses import dataclass, field, replace
from math import copysign, hypot
from typing import Literal

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import (
    Rows,
    Vector,
    cross,
    dot,
    plus,
    product,
    rotated,
    rotated_back,
    scaled,
    speeds_between,
)
from control.axis_task import CELLS, AxisLimits, AxisTask, masked
from forcemesh.messages import ZERO3, Gains, Vec3

Contact = Literal["free", "approach", "contact"]
RELEASE_FRACTION = 0.5  # contact ends below this share of the touch force
LONGEST_CONTACT_LEVER_M = 0.1  # a contact farther from the TCP is treated as noise
APPROACH_INERTIA_SHARE = 0.1  # largest inertial force of the approach, relative to the touch force


@dataclass(frozen=True, slots=True)
class LawSettings:
    """Parameters of the law besides the gains."""

    deadband_N: float
    deadband_Nm: float
    approach_m_s: float
    approach_accel_m_s2: float  # low enough that the tool's inertia does not look like contact
    touch_N: float
    rest_N: float = 0.0  # a smaller error is rounding of the set point: it would never come to rest

    @classmethod
    def of(cls, cell: CellConfig) -> "LawSettings":
        """Return the settings of a cell."""
        force, plant = cell.force, cell.plant
        return cls(
            deadband_N=force.deadband_N,
            rest_N=plant.rounding_m * plant.stiffness_N_m,
            deadband_Nm=force.deadband_Nm,
            approach_m_s=plant.probe_m_s,
            approach_accel_m_s2=APPROACH_INERTIA_SHARE * force.touch_N / plant.inertia_kg,
            touch_N=force.touch_N,
        )


@dataclass(slots=True)
class LawMotion:
    """Commanded pose, what a law wants for the next one, and the last errors."""

    T_base_tcp: pin.SE3
    error_force_N: Vec3 | None = None  # before the first sample: no proportional kick
    error_torque_Nm: Vec3 | None = None
    contact: Contact = "free"
    approach_m_s: float = 0.0  # present speed of the approach
    shift_m: Vec3 = ZERO3  # wanted in this period, base axes
    turn_rad: Vec3 = ZERO3  # the same: rotation vector
    speed_m_s: Vec3 = ZERO3  # commanded by force control, without what a turn adds, base axes
    # From the TCP to the contact point, base axes, where torque turns a tool that moves.
    lever_m: Vector | None = None
    follows: bool = False  # tracks a moving surface along the press axis


@dataclass(slots=True)
class LawInput:
    """Wrench sample and targets of one period, and the motion so far."""

    force_N: Vec3  # of the environment on the tool, base axes
    torque_Nm: Vec3  # about the TCP, base axes
    task: AxisTask  # task frame, controlled axes and set points
    dt_s: float  # since the last sample
    gains: Gains
    motion: LawMotion  # so far; its pose is the last command after the arbiter's limits
    T_measured: pin.SE3  # of the TCP in base
    pose_is_new: bool = True  # the robot has reported a pose since the last sample
    gain_share: float = 1.0  # already in the gains: see delay_monitor.py
    R_base_task: Rows = field(init=False)  # at the motion so far
    arm_m: Vec3 = field(init=False, default=ZERO3)  # from the frame's origin to the TCP
    press_axis: Vec3 = field(init=False)  # direction of the force set point, base axes

    def __post_init__(self) -> None:
        """Convert the orientation once for all that use it."""
        R_base_tcp = self.motion.T_base_tcp.rotation.tolist()
        self.R_base_task = self.task.R_base_task(R_base_tcp)
        self.press_axis = rotated(self.R_base_task, self.task.press_axis)
        if self.task.origin_m is not None:
            self.arm_m = self.task.arm_m(self.motion.T_base_tcp.translation.tolist())

    @property
    def moves(self) -> bool:
        """Whether force control moves the tool along any axis."""
        return any(self.task.force_along)

    @property
    def rotates(self) -> bool:
        """Whether torque control turns it about any axis."""
        return any(self.task.torque_about)

    def task_torque_Nm(self) -> Vec3:
        """Return the torque about the origin of the frame, or about the TCP. Shape (3,)."""
        if self.task.origin_m is None:
            return self.torque_Nm
        return plus(self.torque_Nm, cross(self.arm_m, self.force_N))


def start_at(T_base_tcp: pin.SE3) -> LawMotion:
    """Return the motion that commands the present pose (bumpless start)."""
    return LawMotion(T_base_tcp.copy())


def back_calculate(motion: LawMotion, T_base_tcp: pin.SE3) -> LawMotion:
    """Return the motion that continues, from rest, at the pose that a limit passed on."""
    return replace(motion, T_base_tcp=T_base_tcp, speed_m_s=ZERO3, approach_m_s=0.0)


def next_motion(
    sample: LawInput, settings: LawSettings, integral_m_s: Vec3 | None = None
) -> LawMotion:
    """Return the motion that is wanted after this sample, without limits.

    A law around this one gives `integral_m_s` [m/s] in place of Ki e, base axes.
    """
    before, gains, dt_s, task = sample.motion, sample.gains, sample.dt_s, sample.task
    # The contact pushes against the press axis.
    error_N = plus(sample.force_N, sample.press_axis, task.press_N)
    error_Nm = plus(sample.task_torque_Nm(), rotated(sample.R_base_task, task.torque_Nm))
    error_N, error_Nm = _beyond_deadbands(sample, settings, error_N, error_Nm)
    contact, lever_m = contact_of(sample, settings.touch_N)
    motion = LawMotion(before.T_base_tcp, error_N, error_Nm, contact, lever_m=lever_m)
    if sample.rotates:
        change_Nm = plus(error_Nm, before.error_torque_Nm or error_Nm, -1.0)
        step_rad = product(gains.torque_p_rad_per_Nm, change_Nm)
        step_rad = plus(step_rad, product(gains.torque_i_rad_per_Nms, error_Nm), dt_s)
        motion.turn_rad = masked(step_rad, task.torque_about, sample.R_base_task)
    if not sample.moves:
        return motion
    if contact == "approach":
        faster_m_s = before.approach_m_s + settings.approach_accel_m_s2 * dt_s
        motion.approach_m_s = min(faster_m_s, settings.approach_m_s)
        step_m = scaled(sample.press_axis, motion.approach_m_s * dt_s)
    else:
        change_N = plus(error_N, before.error_force_N or error_N, -1.0)
        speed_m_s = integral_m_s or product(gains.force_i_m_per_Ns, error_N)
        step_m = plus(product(gains.force_p_m_per_N, change_N), speed_m_s, dt_s)
    motion.shift_m = masked(step_m, task.force_along, sample.R_base_task)
    return motion


def _beyond_deadbands(
    sample: LawInput, settings: LawSettings, error_N: Vec3, error_Nm: Vec3
) -> tuple[Vec3, Vec3]:
    """Return the errors of force and torque beyond their deadbands, base axes. Shapes (3,)."""
    R, (bands_N, bands_Nm) = sample.R_base_task, sample.task.deadbands
    if bands_N == bands_Nm == CELLS:
        force_N = soft_deadband(error_N, settings.deadband_N, settings.rest_N)
        return force_N, soft_deadband(error_Nm, settings.deadband_Nm)
    along_N, about_Nm = rotated_back(R, error_N), rotated_back(R, error_Nm)
    along_N = task_deadband(along_N, settings.deadband_N, settings.rest_N, bands_N)
    about_Nm = task_deadband(about_Nm, settings.deadband_Nm, 0.0, bands_Nm)
    return rotated(R, along_N), rotated(R, about_Nm)


def contact_of(sample: LawInput, touch_N: float) -> tuple[Contact, Vector | None]:
    """Return the contact state and, where torque turns a tool that moves, the lever of its contact.

    The state is a force threshold with hysteresis, below it approach or free. The vector ends at
    the line along which the force acts: r = F x M / |F|^2. Shape (3,). A rotation about the TCP
    moves the contact point by turn x r; compensating that motion (`shape.py`) keeps the force
    constant, without waiting for the force loop and its delay.
    """
    force_N, before, press_N = sample.force_N, sample.motion, sample.task.press_N
    presses = press_N > 0.0 and sample.task.searches
    threshold_N = min(touch_N, 0.5 * press_N) if presses else touch_N
    if before.contact == "contact":
        threshold_N *= RELEASE_FRACTION
    contact: Contact = "approach" if presses else "free"
    if -dot(force_N, sample.press_axis) > threshold_N:
        contact = "contact"
    task = sample.task
    if not (sample.rotates and any(task.moving[0])) or task.origin_m is not None:
        return contact, None
    return contact, lever_of(sample, touch_N)


def lever_of(sample: LawInput, touch_N: float) -> Vec3:
    """Return the vector from the TCP to the line along which a force acts, zero without one [m]."""
    square = dot(sample.force_N, sample.force_N)
    if square < touch_N * touch_N:
        return ZERO3
    lever_m = scaled(cross(sample.force_N, sample.torque_Nm), 1.0 / square)
    return limit_norm(lever_m, LONGEST_CONTACT_LEVER_M)


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


def soft_deadband(error: Vector, width: float, rest: float = 0.0) -> Vec3:
    """Shorten a vector by `width`, to zero when it is shorter: continuous, direction kept.

    A vector shorter than `rest` is zero as well, with a step at that length.
    """
    size = hypot(*error)
    return scaled(error, 1.0 - width / size) if size > max(width, rest) else ZERO3


def task_deadband(error: Vector, width: float, rest: float, own: AxisLimits) -> Vec3:
    """Return an error beyond its deadband, along the axes of the task frame. Shape (3,).

    Args:
        error: Force or torque. Shape (3,).
        width: Deadband that the axes without one of their own share.
        rest: A smaller error is zero as well.
        own: Deadband of each axis.
    """
    if own == CELLS:
        return soft_deadband(error, width, rest)
    pairs = [*zip(error, own, strict=True)]
    shared = soft_deadband([e if band is None else 0.0 for e, band in pairs], width, rest)
    x, y, z = [
        kept if band is None else copysign(max(abs(e) - band, 0.0), e)
        for (e, band), kept in zip(pairs, shared, strict=True)
    ]
    return (x, y, z)


def limit_norm(vector: Vec3, longest: float) -> Vec3:
    """Shorten a vector to at most `longest`, direction kept."""
    size = hypot(*vector)
    return vector if size <= longest else scaled(vector, longest / size)
