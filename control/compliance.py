"""Compliant axes of a task frame, with force control along the others. Pure.

Along each compliant axis a virtual mass, damper and spring respond to the force (N. Hogan,
Impedance control, 1985), with F' the force beyond a deadband and x the deviation from the
reference:

    M dv/dt = F' - D v - K x,    D >= (k + K) tau / 0.45

Six of them without a spring are hand guiding. M is larger than the tool's own mass, so the tool's
inertial force in the sensor's reading cannot drive it. D follows the gain rule for a contact of
stiffness k behind the loop delay. k starts at the stiffness of a hand's grip. It rises at once when
the force grows against the travel (a contact stiffer than a hand), and decays while a force moves
the tool along. The deadband at rest equals the residual that the preflight allows in free space, so
the tool does not drift. It narrows with the speed, but never so far that a force within it could
keep the tool moving. About an axis, the damping is at least the inverse of the torque integral
gain; without mass, damping and spring of its own an axis turns by torque control at set point 0,
which has no lag beyond the loop's.
"""

from dataclasses import dataclass, field
from math import exp, hypot
from typing import Self

import pinocchio as pin

from common.config.cell import CellConfig
from common.config.plant import Delays
from common.motion.frames import (
    Speeds,
    Vector,
    moved,
    plus,
    product,
    rotated,
    rotated_back,
    scaled,
    speeds_between,
)
from common.motion.rate_limiter import REST
from control.axis_task import CELLS, AxisTask, VirtualMass
from control.delay_model import LoopDelayModel
from control.gain_rule import LOOP_GAIN
from control.law import LawInput, task_deadband
from forcemesh.messages import ZERO3, AxisState, Vec3
from forcemesh.requests import ForceTask

HAND_N_M = 1500.0  # largest stiffness of a hand's grip
MASSES = 4.0  # M relative to the mass in front of the sensor
NARROWS = 0.5  # of D v: below one, so that a force within the deadband comes to rest
NARROWEST = 0.25  # of the deadband at rest
TORQUE_DEADBAND = 0.5  # of the residual torque allowed in free space
RECENT_S = 0.01  # time constant of the means from which the stiffness is computed
LEAST_N, LEAST_M = 1.0, 3e-5  # smaller changes are noise of sensor and pose
STIFFER_THAN_CONTACT = 1.1
RELAX_M, RELAX_S = 0.001, 0.5  # decay of k per travel and time while the force moves the tool
AT_LIMIT = 0.999  # of its deviation: an axis there is at the limit
LEAST_GAIN = 1e-9  # a request may set the torque gain to zero


def resting_deadband_Nm(cell: CellConfig) -> float:
    """Return the torque within which a guided tool does not turn [N m]."""
    return max(TORQUE_DEADBAND * cell.force.idle_max_Nm, cell.force.deadband_Nm)


@dataclass(frozen=True, slots=True)
class ComplianceSettings:
    """Constants of compliance for one cell."""

    deadband_N: float  # within it a tool at rest does not drift
    deadband_Nm: float
    tau_s: float
    mass_kg: float
    inertia_kg_m2: float
    wrench_filter: Delays  # from the measured pose to the filtered force
    stiffest_N_m: float

    @classmethod
    def of(cls, cell: CellConfig) -> "ComplianceSettings":
        """Return the constants of a cell."""
        force, plant = cell.force, cell.plant
        return cls(
            deadband_N=max(force.idle_max_N, force.deadband_N),
            deadband_Nm=resting_deadband_Nm(cell),
            tau_s=plant.tau_s,
            mass_kg=MASSES * plant.inertia_kg,
            inertia_kg_m2=MASSES * plant.inertia_kg_m2,
            wrench_filter=plant.wrench,
            stiffest_N_m=max(STIFFER_THAN_CONTACT * plant.stiffness_N_m, HAND_N_M),
        )


@dataclass(slots=True)
class ComplianceState:
    """Reference, virtual speeds and estimated stiffness; advanced in place. Task axes."""

    axes: tuple[object, ...]  # those that refer to the reference, with their deviations
    T_reference: pin.SE3  # of the TCP in base; a path moves it
    T_measured: pin.SE3  # of the TCP
    measured: LoopDelayModel = field(default_factory=lambda: LoopDelayModel(ZERO3))  # base axes
    k_N_m: list[float] = field(default_factory=lambda: [HAND_N_M] * 3)
    recent_m: list[float] = field(default_factory=lambda: [0.0] * 3)  # low-passed travel and force
    recent_N: list[float] = field(default_factory=lambda: [0.0] * 3)
    speed_m_s: Vector = ZERO3
    speed_rad_s: Vector = ZERO3
    at_limit: list[bool] = field(default_factory=lambda: [False] * 6)

    @classmethod
    def at(cls, task: AxisTask, T_base_tcp: pin.SE3, T_measured: pin.SE3) -> Self:
        """Return the state of a tool at rest at its reference, in free space."""
        return cls(referring(task), T_base_tcp.copy(), T_measured.copy())

    def covers(self, task: AxisTask) -> bool:
        """Return whether the reference stays for a changed task: the same axes refer to it."""
        return referring(task) == self.axes

    def move(self, travel: Speeds) -> None:
        """Move the reference by shift and rotation about the TCP, base axes."""
        self.T_reference = moved(self.T_reference, travel, 1.0)

    def deviation(self, T_base_tcp: pin.SE3, sample: LawInput) -> tuple[Vec3, Vec3]:
        """Return travel [m] and rotation [rad] from the reference, task axes. Shapes (3,)."""
        moved_m, turned_rad = speeds_between(self.T_reference, T_base_tcp, 1.0)
        R = sample.R_base_task
        return rotated_back(R, moved_m), rotated_back(R, turned_rad)

    def keep(self, wanted: Speeds, left: Speeds, sample: LawInput) -> None:
        """Continue each virtual mass at what limits have left of its motion in a period.

        Nothing that moves the tool as well, such as a turn, gives a mass a speed.
        """
        if sample.task.complies:
            R, per_s = sample.R_base_task, 1.0 / sample.dt_s
            self.speed_m_s, self.speed_rad_s = (
                scaled(product(_left_of(rotated_back(R, own), rotated_back(R, rest)), axes), per_s)
                for own, rest, axes in zip(wanted, left, sample.task.compliant, strict=True)
            )

    def rest(self) -> None:
        """Bring the virtual masses to rest, as the tool is."""
        self.speed_m_s = self.speed_rad_s = ZERO3

    def note_limits(self, T_base_tcp: pin.SE3, sample: LawInput) -> None:
        """Note which axes are at the limits of their deviations."""
        limits_m, limits_rad = sample.task.deviations
        if limits_m == limits_rad == CELLS:
            return
        away_m, away_rad = self.deviation(T_base_tcp, sample)
        pairs = zip((*away_m, *away_rad), (*limits_m, *limits_rad), strict=True)
        self.at_limit = [
            limit is not None and abs(away) > AT_LIMIT * limit for away, limit in pairs
        ]


def referring(task: AxisTask) -> tuple[object, ...]:
    """Return the axes of a task that refer to a reference, and their limits."""
    return tuple(
        each is not None for each in (*task.compliant_along, *task.compliant_about)
    ), task.deviations


def _left_of(own: Vec3, rest: Vec3) -> Vec3:
    """Return what is left of each value: between zero and itself."""
    x, y, z = [
        min(max(left, min(value, 0.0)), max(value, 0.0))
        for value, left in zip(own, rest, strict=True)
    ]
    return (x, y, z)


def comply(state: ComplianceState, sample: LawInput, settings: ComplianceSettings) -> Speeds:
    """Return what the compliant axes want in this period: shift [m], rotation [rad], base axes."""
    if not sample.task.complies:
        return REST
    R, dt_s = sample.R_base_task, sample.dt_s
    away_m, away_rad = state.deviation(sample.motion.T_base_tcp, sample)
    speed_m_s = _speeds_along(state, sample, settings, away_m)
    speed_rad_s = _speeds_about(state, sample, settings, away_rad)
    return rotated(R, scaled(speed_m_s, dt_s)), rotated(R, scaled(speed_rad_s, dt_s))


def axis_states(task: ForceTask, sample: LawInput, state: ComplianceState) -> tuple[AxisState, ...]:
    """Return the present state of each axis, for the target of the regulator."""
    R, now = sample.R_base_task, sample.task
    loads = (*rotated_back(R, sample.force_N), *rotated_back(R, sample.task_torque_Nm()))
    away_m, away_rad = state.deviation(sample.motion.T_base_tcp, sample)
    values = zip(
        task.axes,
        (*now.force_N, *now.torque_Nm),
        loads,
        (*away_m, *away_rad),
        state.at_limit,
        strict=True,
    )
    return tuple(
        AxisState(
            control=axis.control,
            setpoint=setpoint,
            exerted=-load,
            deviation=deviation,
            at_limit=at_limit,
        )
        for axis, setpoint, load, deviation, at_limit in values
    )


def _speeds_along(
    state: ComplianceState, sample: LawInput, settings: ComplianceSettings, away_m: Vec3
) -> Vec3:
    """Return the speeds along the compliant axes, task axes [m/s]. Shape (3,)."""
    task, rest_N = sample.task, settings.deadband_N
    force_N = rotated_back(sample.R_base_task, sample.force_N)
    _update_stiffness(state, sample, force_N, settings)
    rule_s = settings.tau_s / (LOOP_GAIN * sample.gain_share)  # damping over stiffness
    used = [each or VirtualMass() for each in task.compliant_along]
    damping_Ns_m = [
        max(rule_s * (k + each.stiffness), each.damping or 0.0)
        for k, each in zip(state.k_N_m, used, strict=True)
    ]
    drag_N = product(damping_Ns_m, state.speed_m_s)
    width_N = max(rest_N - NARROWS * hypot(*drag_N), NARROWEST * rest_N)
    complies, _ = task.compliant
    # A deadband that widens as the tool comes to rest would let a spring pull it back into motion.
    x, y, z = [
        rest_N if own is None and each.stiffness > 0.0 else own
        for own, each in zip(task.deadbands[0], used, strict=True)
    ]
    push_N = task_deadband(product(force_N, complies), width_N, 0.0, (x, y, z))
    loads = zip(state.speed_m_s, push_N, damping_Ns_m, used, away_m, strict=True)
    speeds = [
        virtual_step(
            v, F, damping=D, virtual=each, least_mass=settings.mass_kg, deviation=x,
            dt_s=sample.dt_s,
        )
        for v, F, D, each, x in loads
    ]  # fmt: skip
    return product(speeds, complies)


def _speeds_about(
    state: ComplianceState, sample: LawInput, settings: ComplianceSettings, away_rad: Vec3
) -> Vec3:
    """Return the angular speeds about the compliant axes, task axes [rad/s]. Shape (3,)."""
    task, gains = sample.task, sample.gains.torque_i_rad_per_Nms
    if not any(task.compliant_about):
        return ZERO3
    _, complies = task.compliant
    torque_Nm = product(rotated_back(sample.R_base_task, sample.task_torque_Nm()), complies)
    load_Nm = task_deadband(torque_Nm, settings.deadband_Nm, 0.0, task.deadbands[1])
    least = 1.0 / max(min(gains), LEAST_GAIN)
    used = [each or VirtualMass() for each in task.compliant_about]
    loads = zip(state.speed_rad_s, load_Nm, used, away_rad, strict=True)
    speeds = [
        virtual_step(
            w, M, damping=max(least, each.damping or 0.0), virtual=each,
            least_mass=settings.inertia_kg_m2, deviation=angle, dt_s=sample.dt_s,
        )
        for w, M, each, angle in loads
    ]  # fmt: skip
    return product(speeds, complies)


def virtual_step(
    speed: float,
    load: float,
    *,
    damping: float,
    virtual: VirtualMass,
    least_mass: float,
    deviation: float,
    dt_s: float,
) -> float:
    """Return the speed of a virtual mass after a period, by the implicit Euler method.

    M dv/dt = F - D v - K x. Units of one axis: N, m and kg, or N m, rad and kg m2.
    """
    K = virtual.stiffness
    share = dt_s / max(virtual.mass or 0.0, least_mass)
    pushed = speed + share * (load - K * deviation)
    return pushed / (1.0 + share * damping + share * dt_s * K)


def _update_stiffness(
    state: ComplianceState, sample: LawInput, force_N: Vec3, settings: ComplianceSettings
) -> None:
    """Update the stiffness estimate by this sample; the force is along the task's axes.

    Unlike the adaptive law's, which is an upper bound that falls as data permit, it begins soft
    and must rise within some samples of a touch.
    """
    dt_s, T, model = sample.dt_s, sample.T_measured, state.measured
    moved_m: Vec3 = (T.translation - state.T_measured.translation).tolist()
    model.follow(plus(model.command, moved_m), dt_s, settings.wrench_filter)
    travel_m = rotated_back(sample.R_base_task, model.filtered)
    state.T_measured = T
    share = 1.0 - exp(-dt_s / RECENT_S)
    for axis in range(3):
        k_N_m, force, speed_m_s = state.k_N_m[axis], force_N[axis], state.speed_m_s[axis]
        d_m, d_N = travel_m[axis] - state.recent_m[axis], force - state.recent_N[axis]
        if force * speed_m_s > 0.0:
            decay = exp(-abs(speed_m_s) * dt_s / RELAX_M - dt_s / RELAX_S)
            k_N_m = HAND_N_M + decay * (k_N_m - HAND_N_M)
        if d_m * d_N < 0.0 and abs(d_m) > LEAST_M and abs(d_N) > LEAST_N:
            slope_N_m = STIFFER_THAN_CONTACT * abs(d_N / d_m)
            k_N_m = max(k_N_m, min(slope_N_m, settings.stiffest_N_m))
        state.k_N_m[axis] = k_N_m
        state.recent_m[axis] += share * d_m
        state.recent_N[axis] += share * d_N
