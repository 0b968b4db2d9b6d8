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
from math import exp

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array, length
from services.regulator import delay_model
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


@dataclass(frozen=True, slots=True)
class AdmittanceState:
    """State of hand guiding; vectors along the tool's axes, of shape (3,)."""

    T_measured: pin.SE3  # of the TCP
    measured: LoopDelayModel  # measured travel through the wrench filter's model, base axes
    k_N_m: Array  # estimated stiffness of the contact
    speed_m_s: Array
    recent_m: Array  # low-passed travel and force
    recent_N: Array


def begin(
    _T_command: pin.SE3, T_measured: pin.SE3, _k: Array | None, _settings: AdmittanceSettings
) -> AdmittanceState:
    """Return the state of a tool at rest in free space."""
    zero = np.zeros(3)
    return AdmittanceState(
        T_measured.copy(), delay_model.at_rest(zero), np.full(3, HAND_N_M), zero, zero, zero
    )


def step(
    state: AdmittanceState, sample: LawInput, settings: AdmittanceSettings
) -> tuple[AdmittanceState, LawMotion]:
    """Return the next state and motion; the PI law's torque gains turn the tool."""
    R, plain = sample.motion.T_base_tcp.rotation, settings.plain
    state = _update_stiffness(state, sample, settings)
    damping_Ns_m = state.k_N_m * settings.tau_s / LOOP_GAIN
    slow_N = NARROWS * length(damping_Ns_m * state.speed_m_s)
    width_N = max(plain.deadband_N - slow_N, NARROWEST * plain.deadband_N)
    push_N = soft_deadband(R.T @ sample.force_N, width_N)
    share = sample.dt_s / settings.mass_kg
    speed_m_s = (state.speed_m_s + share * push_N) / (1.0 + share * damping_Ns_m)
    speed_m_s = limit_norm(speed_m_s, plain.speed_max_m_s)
    zero = np.zeros(3)
    gains = replace(sample.gains, force_p_m_per_N=zero, force_i_m_per_Ns=zero)
    guided = replace(sample, drift_m_s=R @ speed_m_s, gains=gains)
    return replace(state, speed_m_s=speed_m_s), next_motion(guided, plain)


def _update_stiffness(
    state: AdmittanceState, sample: LawInput, settings: AdmittanceSettings
) -> AdmittanceState:
    """Return the state with the stiffness estimate updated by this sample."""
    R, dt_s = sample.motion.T_base_tcp.rotation, sample.dt_s
    moved_m = state.measured.command + sample.T_measured.translation - state.T_measured.translation
    measured = delay_model.follow(state.measured, moved_m, dt_s, settings.wrench_filter)
    now_m, now_N = R.T @ measured.filtered, R.T @ sample.force_N
    d_m, d_N = now_m - state.recent_m, now_N - state.recent_N
    is_informative = (d_m * d_N < 0.0) & (np.abs(d_m) > LEAST_M) & (np.abs(d_N) > LEAST_N)
    slope_N_m = STIFFER_THAN_CONTACT * np.abs(d_N) / np.maximum(np.abs(d_m), LEAST_M)
    travel_m = np.abs(state.speed_m_s) * dt_s
    yields = now_N * state.speed_m_s > 0.0
    decay = np.where(yields, np.exp(-travel_m / RELAX_M - dt_s / RELAX_S), 1.0)
    k_N_m = HAND_N_M + decay * (state.k_N_m - HAND_N_M)
    k_N_m = np.where(
        is_informative, np.maximum(k_N_m, np.minimum(slope_N_m, settings.stiffest_N_m)), k_N_m
    )
    share = 1.0 - exp(-dt_s / RECENT_S)
    return replace(
        state,
        T_measured=sample.T_measured,
        measured=measured,
        k_N_m=k_N_m,
        recent_m=state.recent_m + share * d_m,
        recent_N=state.recent_N + share * d_N,
    )
