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
from common.motion.frames import Vector, plus, product, rotated, rotated_back, scaled
from forcemesh.messages import ZERO3, Vec3
from services.regulator.delay_model import DelayModelSettings, LoopDelayModel
from services.regulator.law import (
    LawInput,
    LawMotion,
    LawSettings,
    limit_norm,
    next_motion,
    soft_deadband,
)
from tuning.gain_rule import LOOP_GAIN

HAND_N_M = 1500.0  # largest stiffness of a hand's grip
MASSES = 4.0  # M relative to the mass in front of the sensor
NARROWS = 0.5  # of D v: below one, so that a force within the deadband comes to rest
NARROWEST = 0.25  # of the deadband at rest
TORQUE_DEADBAND = 0.5  # of the residual torque allowed in free space
RECENT_S = 0.01  # time constant of the means from which the stiffness is computed
LEAST_N, LEAST_M = 1.0, 3e-5  # smaller changes are noise of sensor and pose
STIFFER_THAN_CONTACT = 1.1
RELAX_M, RELAX_S = 0.001, 0.5  # decay of k per travel and time while the force moves the tool


@dataclass(frozen=True, slots=True)
class AdmittanceSettings:
    """Constants of hand guiding for one cell."""

    plain: LawSettings  # of the PI law, with the deadband at rest
    tau_s: float
    mass_kg: float
    wrench_filter: DelayModelSettings  # from the measured pose to the filtered force
    stiffest_N_m: float

    @classmethod
    def of(cls, cell: CellConfig) -> "AdmittanceSettings":
        """Return the constants of a cell."""
        force, contact = cell.force, cell.contact
        plain = replace(
            LawSettings.of(cell),
            deadband_N=max(force.idle_max_N, force.deadband_N),
            deadband_Nm=max(TORQUE_DEADBAND * force.idle_max_Nm, force.deadband_Nm),
        )
        return cls(
            plain,
            cell.loop_delay_s,
            MASSES * contact.inertia_kg,
            DelayModelSettings.of_wrench(cell),
            stiffest_N_m=max(STIFFER_THAN_CONTACT * contact.stiffness_N_m, HAND_N_M),
        )


@dataclass(slots=True)
class AdmittanceState:
    """State of hand guiding, advanced in place; vectors along the tool's axes."""

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
    R_base_tcp, plain, dt_s = sample.R_base_tcp, settings.plain, sample.dt_s
    force_N = rotated_back(R_base_tcp, sample.force_N)
    _update_stiffness(state, sample, force_N, settings)
    damping_Ns_m = scaled(state.k_N_m, settings.tau_s / LOOP_GAIN)
    drag_N = product(damping_Ns_m, state.speed_m_s)
    width_N = max(plain.deadband_N - NARROWS * hypot(*drag_N), NARROWEST * plain.deadband_N)
    push_N = soft_deadband(force_N, width_N)
    share = dt_s / settings.mass_kg
    x, y, z = [
        (v + share * F) / (1.0 + share * D)
        for v, F, D in zip(state.speed_m_s, push_N, damping_Ns_m, strict=True)
    ]
    state.speed_m_s = limit_norm((x, y, z), plain.speed_max_m_s)
    guided = replace(sample, gains=replace(sample.gains, force_p_m_per_N=ZERO3))
    return state, next_motion(guided, plain, rotated(R_base_tcp, state.speed_m_s))


def _update_stiffness(
    state: AdmittanceState, sample: LawInput, force_N: Vec3, settings: AdmittanceSettings
) -> None:
    """Update the stiffness estimate by this sample; the force is along the tool's axes."""
    dt_s, T, model = sample.dt_s, sample.T_measured, state.measured
    moved_m: Vec3 = (T.translation - state.T_measured.translation).tolist()
    model.follow(plus(model.command, moved_m), dt_s, settings.wrench_filter)
    travel_m = rotated_back(sample.R_base_tcp, model.filtered)
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
