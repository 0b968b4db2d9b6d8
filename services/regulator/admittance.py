"""Hand guiding: the tool gives way to a hand as a light thing in oil would. Pure.

Along each axis of the tool, F' the force beyond a deadband,

    M dv/dt = F' - D v,    D = k tau / 0.45

M is larger than the tool's own mass, so the tool's inertia in the sensor's reading cannot push; the
damping bears the grip of a hand through the loop's delay: k begins there. What is stiffer than a
hand is felt by the force that rises against the way: k goes up at once, so the damping is what the
gain rule asks for, and comes down again where a force moves the tool along. The deadband is as wide
at rest as what the preflight allows to be left in free space, so nothing drifts away; with the
speed it gets narrower, but never so fast that a force within it could keep the tool going.
"""

from dataclasses import dataclass, replace
from math import exp

import numpy as np
import pinocchio as pin

from common.config.cell import Cell
from common.motion.frames import Array, length
from services.regulator import delay_model as way
from services.regulator.delay_model import Path, PathSettings
from services.regulator.law import (
    LawInput,
    LawSettings,
    LawState,
    PiGains,
    limit_norm,
    soft_deadband,
    step,
)
from tuning.gain_rule import LOOP_GAIN

HAND_N_M = 1500.0  # how stiff a hand grips at most
MASSES = 4.0  # M, of the mass in front of the sensor
NARROWS = 0.5  # of D v: below one, so that a force within the deadband comes to rest
NARROWEST = 0.25  # of the deadband at rest
TURN_DEADBAND = 0.5  # of the torque that may be left in free space
RECENT_S = 0.01  # what changed within such a time tells the stiffness
LEAST_N, LEAST_M = 1.0, 3e-5  # smaller changes are noise of sensor and pose
STIFFER = 1.1
RELAX_M, RELAX_S = 0.001, 0.5  # of way and time: while the force moves the tool along, k falls


@dataclass(frozen=True, slots=True)
class GuideSettings:
    """What hand guiding knows of the cell."""

    tau_s: float
    mass_kg: float
    deadband_N: float
    deadband_Nm: float
    speed_max_m_s: float
    path: PathSettings  # of the measured way to the filtered force
    stiffest_N_m: float

    @classmethod
    def of(cls, cell: Cell) -> "GuideSettings":
        """Take them out of a cell file."""
        path, tau_s = PathSettings.of(cell), cell.loop_delay_s
        return cls(
            tau_s=tau_s,
            mass_kg=MASSES * cell.contact.inertia_kg,
            deadband_N=max(cell.force.idle_max_N, cell.force.deadband_N),
            deadband_Nm=max(TURN_DEADBAND * cell.force.idle_max_Nm, cell.force.deadband_Nm),
            speed_max_m_s=cell.force.speed_max_m_s,
            path=PathSettings(path.median_s, 0.0, path.filter_s, path.median_s),
            stiffest_N_m=max(STIFFER * cell.contact.stiffness_N_m, HAND_N_M),
        )


@dataclass(frozen=True, slots=True)
class Guide:
    """What is remembered while a hand guides; vectors along the tool's axes, of shape (3,)."""

    T_measured: pin.SE3  # of the TCP
    measured: Path  # the way of it as the filtered force feels it, base axes
    k_N_m: Array  # of what opposes
    speed_m_s: Array
    recent_m: Array  # slow means of way and force
    recent_N: Array


def begin(T_measured: pin.SE3) -> Guide:
    """Return the memory of a tool at rest that nobody holds."""
    zero = np.zeros(3)
    return Guide(T_measured.copy(), way.at_rest(zero), np.full(3, HAND_N_M), zero, zero, zero)


def advance(
    law: LawState,
    guide: Guide,
    sample: LawInput,
    T_measured: pin.SE3,
    *,
    gains: PiGains,
    plain: LawSettings,
    settings: GuideSettings,
) -> tuple[LawState, Guide]:
    """Return the next state and memory.

    Args:
        law: State of the plain law; its pose is what was let through of the last command.
        guide: What is remembered.
        sample: One wrench; its set point is 0.
        T_measured: Pose of the TCP, in base.
        gains: Of the plain law: those of torque turn the tool.
        plain: Settings of the plain law.
        settings: Settings of this one.
    """
    R = law.T_base_tcp.rotation
    guide = _felt(guide, R, sample, T_measured=T_measured, settings=settings)
    damping_Ns_m = guide.k_N_m * settings.tau_s / LOOP_GAIN
    slow_N = NARROWS * length(damping_Ns_m * guide.speed_m_s)
    width_N = max(settings.deadband_N - slow_N, NARROWEST * settings.deadband_N)
    push_N = soft_deadband(R.T @ sample.force_N, width_N)
    share = sample.dt_s / settings.mass_kg
    speed_m_s = (guide.speed_m_s + share * push_N) / (1.0 + share * damping_Ns_m)
    speed_m_s = limit_norm(speed_m_s, settings.speed_max_m_s)
    fed = replace(sample, drift_m_s=R @ speed_m_s)
    still = np.zeros(3)
    tuned = replace(gains, force_p_m_per_N=still, force_i_m_per_Ns=still)
    wide = replace(plain, deadband_N=settings.deadband_N, deadband_Nm=settings.deadband_Nm)
    return step(law, fed, tuned, wide), replace(guide, speed_m_s=speed_m_s)


def _felt(
    guide: Guide, R: Array, sample: LawInput, *, T_measured: pin.SE3, settings: GuideSettings
) -> Guide:
    """Return the memory with what this sample says about what the tool meets."""
    moved_m = guide.measured.command + T_measured.translation - guide.T_measured.translation
    measured = way.follow(guide.measured, moved_m, sample.dt_s, settings.path)
    now_m, now_N = R.T @ measured.felt, R.T @ sample.force_N
    d_m, d_N = now_m - guide.recent_m, now_N - guide.recent_N
    tells = (d_m * d_N < 0.0) & (np.abs(d_m) > LEAST_M) & (np.abs(d_N) > LEAST_N)
    slope_N_m = STIFFER * np.abs(d_N) / np.maximum(np.abs(d_m), LEAST_M)
    way_m, dt_s = np.abs(guide.speed_m_s) * sample.dt_s, sample.dt_s
    gives_way = now_N * guide.speed_m_s > 0.0
    kept = np.where(gives_way, np.exp(-way_m / RELAX_M - dt_s / RELAX_S), 1.0)
    k_N_m = HAND_N_M + kept * (guide.k_N_m - HAND_N_M)
    k_N_m = np.where(tells, np.maximum(k_N_m, np.minimum(slope_N_m, settings.stiffest_N_m)), k_N_m)
    share = 1.0 - exp(-dt_s / RECENT_S)
    return replace(
        guide,
        T_measured=T_measured,
        measured=measured,
        k_N_m=k_N_m,
        recent_m=guide.recent_m + share * d_m,
        recent_N=guide.recent_N + share * d_N,
    )
