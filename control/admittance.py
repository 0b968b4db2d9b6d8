"""Hand guiding: admittance control with damping scheduled on the estimated stiffness. Pure.

Along each axis of the tool, with F' the force beyond a deadband,

    M dv/dt = F' - D v,    D = k tau / 0.45

Virtual mass and damping are those of admittance control (N. Hogan, Impedance control, 1985). M is
larger than the tool's own mass, so the tool's inertial force in the sensor's reading cannot drive
it. D follows the gain rule for a contact of stiffness k behind the loop delay tau. k starts at the
stiffness of a hand's grip. It rises at once when the force grows against the travel (a contact
stiffer than a hand), and decays while a force moves the tool along. The deadband at rest equals the
residual that the preflight allows in free space, so the tool does not drift. It narrows with the
speed, but never so far that a force within it could keep the tool moving.
"""

from dataclasses import dataclass, replace
from math import exp, hypot

import pinocchio as pin

from common.config.cell import CellConfig
from common.config.plant import Delays
from common.motion.frames import Vector, plus, product, rotated, rotated_back
from control.axis_task import VirtualMass
from control.delay_model import LoopDelayModel
from control.gain_rule import LOOP_GAIN
from control.law import (
    LawInput,
    LawMotion,
    LawSettings,
    limit_norm,
    next_motion,
    task_deadband,
)
from forcemesh.messages import ZERO3, Vec3

FREE = (VirtualMass(),) * 3
HAND_N_M = 1500.0  # largest stiffness of a hand's grip
MASSES = 4.0  # M relative to the mass in front of the sensor
NARROWS = 0.5  # of D v: below one, so that a force within the deadband comes to rest
NARROWEST = 0.25  # of the deadband at rest
TORQUE_DEADBAND = 0.5  # of the residual torque allowed in free space
RECENT_S = 0.01  # time constant of the means from which the stiffness is computed
LEAST_N, LEAST_M = 1.0, 3e-5  # smaller changes are noise of sensor and pose
STIFFER_THAN_CONTACT = 1.1
RELAX_M, RELAX_S = 0.001, 0.5  # decay of k per travel and time while the force moves the tool


def resting_deadband_N(cell: CellConfig) -> float:
    """Return the force within which a guided tool at rest does not drift [N]."""
    return max(cell.force.idle_max_N, cell.force.deadband_N)


def resting_deadband_Nm(cell: CellConfig) -> float:
    """Return the torque within which a guided tool does not turn [N m]."""
    return max(TORQUE_DEADBAND * cell.force.idle_max_Nm, cell.force.deadband_Nm)


@dataclass(frozen=True, slots=True)
class AdmittanceSettings:
    """Constants of hand guiding for one cell."""

    plain: LawSettings  # of the PI law, with the deadband at rest
    tau_s: float
    mass_kg: float
    wrench_filter: Delays  # from the measured pose to the filtered force
    stiffest_N_m: float

    @classmethod
    def of(cls, cell: CellConfig) -> "AdmittanceSettings":
        """Return the constants of a cell."""
        plant = cell.plant
        plain = replace(
            LawSettings.of(cell),
            deadband_N=resting_deadband_N(cell),
            deadband_Nm=resting_deadband_Nm(cell),
        )
        return cls(
            plain,
            plant.tau_s,
            MASSES * plant.inertia_kg,
            plant.wrench,
            stiffest_N_m=max(STIFFER_THAN_CONTACT * plant.stiffness_N_m, HAND_N_M),
        )


@dataclass(slots=True)
class AdmittanceState:
    """State of hand guiding, advanced in place; vectors along the axes of the task frame."""

    T_measured: pin.SE3  # of the TCP
    measured: LoopDelayModel  # measured travel through the wrench filter's model, base axes
    k_N_m: list[float]  # estimated stiffness of the contact
    speed_m_s: Vector
    recent_m: list[float]  # low-passed travel and force
    recent_N: list[float]


def begin(
    _T_command: pin.SE3, T_measured: pin.SE3, _k: Vector | None, _settings: AdmittanceSettings
) -> AdmittanceState:
    """Return the state of a tool at rest in free space."""
    model, k_N_m = LoopDelayModel(ZERO3), [HAND_N_M] * 3
    return AdmittanceState(T_measured.copy(), model, k_N_m, ZERO3, [0.0] * 3, [0.0] * 3)


def step(
    state: AdmittanceState, sample: LawInput, settings: AdmittanceSettings
) -> tuple[AdmittanceState, LawMotion]:
    """Advance the state; return it and the motion. The PI law's torque gains turn the tool."""
    speed_m_s = rotated(sample.R_base_task, virtual_speed(state, sample, settings))
    guided = replace(sample, gains=replace(sample.gains, force_p_m_per_N=ZERO3))
    return state, next_motion(guided, settings.plain, speed_m_s)


def virtual_speed(
    state: AdmittanceState,
    sample: LawInput,
    settings: AdmittanceSettings,
    *,
    masses: tuple[VirtualMass | None, ...] = FREE,
    deviation_m: Vector = ZERO3,
) -> Vector:
    """Advance the state; return the speed along the axes of the task frame [m/s]. Shape (3,).

    Args:
        state: Advanced in place.
        sample: Wrench and task.
        settings: Constants of the cell.
        masses: Virtual mass, damper and spring of each axis; None: the axis does not comply.
        deviation_m: From the reference of the springs.
    """
    plain, dt_s = settings.plain, sample.dt_s
    force_N = rotated_back(sample.R_base_task, sample.force_N)
    _update_stiffness(state, sample, force_N, settings)
    rule_s = settings.tau_s / (LOOP_GAIN * sample.gain_share)  # damping over stiffness
    used = [each or VirtualMass() for each in masses]
    damping_Ns_m = [
        max(rule_s * (k + each.stiffness), each.damping or 0.0)
        for k, each in zip(state.k_N_m, used, strict=True)
    ]
    drag_N = product(damping_Ns_m, state.speed_m_s)
    width_N = max(plain.deadband_N - NARROWS * hypot(*drag_N), NARROWEST * plain.deadband_N)
    complies = [each is not None for each in masses]
    push_N = task_deadband(product(force_N, complies), width_N, 0.0, sample.task.deadbands[0])
    loads = zip(state.speed_m_s, push_N, damping_Ns_m, used, deviation_m, strict=True)
    speeds = [
        virtual_step(
            v, F, damping=D, virtual=each, least_mass=settings.mass_kg, deviation=x, dt_s=dt_s
        )
        for v, F, D, each, x in loads
    ]
    state.speed_m_s = limit_norm(product(speeds, complies), plain.speed_max_m_s)
    return state.speed_m_s


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
    state: AdmittanceState, sample: LawInput, force_N: Vec3, settings: AdmittanceSettings
) -> None:
    """Update the stiffness estimate by this sample; the force is along the task's axes."""
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
