"""Adaptive law: PI law with gain scheduling, Smith predictor and surface feed-forward. Pure.

Along each axis of the tool, with k the estimated contact stiffness and tau the loop delay:

    Ki  = min(c / (k tau), 1.5 / (m w_b))  c from 0.45 to 3.4 with the prediction w; braked: heat.py
    F'  = F + 0.7 m a - w k (x_command - x_felt)      force once all commands have arrived
    v   = Ki (F' - F_set) + v_surface                 v_surface: press axis only

F' is a Smith predictor (O. J. M. Smith, Closer control of loops with dead time, 1957). x_felt is
the command passed through the delay model up to the filtered force (`path.py`). k is identified
from the measured pose (`stiffness.py`) and reduced by the arm's own compliance (`response.py`).
The weight w of the prediction grows with the gain: where inertia caps the gain there is little to
predict, and a slow loop tolerates less gain and less inertia compensation. w stays below one,
because k is an upper bound: a prediction 10 % too large costs another round trip, one 10 % too
small a few per cent of overshoot. Surface tracking starts once the force has been near its set
point.
"""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array, length
from services.regulator import contact_travel as ways
from services.regulator import response
from services.regulator import stiffness as stiff
from services.regulator.contact_travel import ContactTravel, MeasuredTravel
from services.regulator.delay_model import DelayModelSettings
from services.regulator.gain_schedule import GainLimits, gain_limits_of, limit_gain_for_braking
from services.regulator.law import LawInput, LawSettings, LawState, PiGains, step
from services.regulator.response import Response, ResponseSample
from services.regulator.stiffness import Stiffness, StiffnessSettings
from services.regulator.surface_tracking import (
    NOT_TRACKING,
    PressAxisState,
    SurfaceTracking,
    followed,
    noise_weight,
)
from tuning.adaptive_map import softest_N_m
from tuning.gain_rule import INERTIA_MARGIN as PLAIN_MARGIN
from tuning.gain_rule import LOOP_GAIN, tune

INERTIA_SHARE = 0.7  # share of the tool's inertial force removed from the control error
IDENTIFICATION_INERTIA_SHARE = 0.9  # the same share for identification: it closes no loop
SURE_INERTIA_MARGIN = (1.5, 0.4)  # of 1 / (m w_b), in a fast loop and a slow one
LOOPS_S = (0.008, 0.016)  # loop periods with full prediction and with none
LEAST_FADE = 0.05  # least share of the gain range over which the prediction fades in, slowest loop

MEMORY_TAUS, MEMORY_PERIODS, MEMORY_LEAST_S = 2.0, 10.0, 0.1  # forgetting of the identification
STIFFER = 1.0  # initial estimate, relative to the stiffest contact of the cell
NOISE_N, LEAST_WAY_M, SOFTEST_N_M = 0.08, 1e-5, 200.0
TOUCH_SHARE = 0.5  # of the touch force: below it there is no contact
FREE_TAUS = 3.0  # time without contact after which the estimates are reset
DEADBAND_IN_CONTACT = 0.25  # of the deadband, which serves against drift in free space


@dataclass(frozen=True, slots=True)
class AdaptiveSettings:
    """Constants of the adaptive law for one cell."""

    tau_s: float
    path: DelayModelSettings
    stiffness: StiffnessSettings
    period_s: float  # nominal: tau holds half of it
    inertia_cap_m_per_Ns: float  # 1 / (m w_b), before its margin
    plain_cap_m_per_Ns: float  # of the gain rule: the plain law compensates no inertia
    plain_gain_m_per_Ns: float  # of the gain rule: requested gains below it reduce the gain
    inertia_kg: float
    touch_N: float
    heat: GainLimits
    softest_N_m: float  # below it the plain law's gain holds: see adaptive_map.py
    predicts: bool
    tracks: bool

    @classmethod
    def of(cls, cell: CellConfig) -> "AdaptiveSettings":
        """Return the constants of a cell."""
        tau_s, contact = cell.loop_delay_s, cell.contact
        slower_hz = min(cell.rates.control_hz, cell.rates.robot_hz)
        memory_s = max(MEMORY_TAUS * tau_s, MEMORY_PERIODS / slower_hz, MEMORY_LEAST_S)
        m_w_b = contact.inertia_kg * cell.robot.bandwidth_rad_s
        return cls(
            tau_s=tau_s,
            period_s=1.0 / cell.rates.control_hz,
            path=DelayModelSettings.of(cell),
            stiffness=StiffnessSettings(
                STIFFER * contact.stiffness_N_m, SOFTEST_N_M, memory_s, NOISE_N, LEAST_WAY_M
            ),
            inertia_cap_m_per_Ns=1.0 / m_w_b,
            plain_cap_m_per_Ns=PLAIN_MARGIN / m_w_b,
            plain_gain_m_per_Ns=tune(cell).force_i_m_per_Ns,
            inertia_kg=contact.inertia_kg,
            touch_N=TOUCH_SHARE * cell.force.touch_N,
            heat=gain_limits_of(cell),
            softest_N_m=softest_N_m(cell) or 0.0,
            predicts=cell.force.delay_compensation,
            tracks=cell.force.surface_tracking,
        )


@dataclass(frozen=True, slots=True)
class AdaptiveState:
    """State of the adaptive law beside that of the PI law. Travel is of the contact point."""

    command: ContactTravel
    measured: MeasuredTravel
    stiffness: Stiffness  # tool axes
    response: Response  # tool axes
    follow: SurfaceTracking = NOT_TRACKING
    free_s: float = 0.0  # time without contact

    @property
    def k(self) -> Array:
        """Stiffness along the tool's axes as seen by the commands [N/m]. Shape (3,)."""
        return self.response.share * self.stiffness.k


def begin(
    T_command: pin.SE3, T_measured: pin.SE3, settings: AdaptiveSettings, k: Array | None = None
) -> AdaptiveState:
    """Return the state of a tool at rest; `k`: stiffness identified here before. Shape (3,)."""
    state = stiff.stiffest(settings.stiffness) if k is None else stiff.believing(k)
    command, measured = ways.begin(T_command), MeasuredTravel(ways.begin(T_measured))
    return AdaptiveState(command, measured, state, response.unheard())


def advance(
    law: LawState,
    memory: AdaptiveState,
    sample: LawInput,
    T_measured: pin.SE3,
    *,
    gains: PiGains,
    plain: LawSettings,
    settings: AdaptiveSettings,
) -> tuple[LawState, AdaptiveState]:
    """Return the next states of the PI law and of the adaptive law.

    Args:
        law: State of the PI law; its pose is the last command after the arbiter's limits.
        memory: State of the adaptive law.
        sample: Wrench and targets of this period.
        T_measured: Pose of the TCP, in base.
        gains: Of the PI law; force integral gains below the gain rule's reduce this law's gain.
        plain: Settings of the PI law.
        settings: Settings of this law.
    """
    R = law.T_base_tcp.rotation
    memory = update_estimates(law, memory, sample, T_measured=T_measured, settings=settings)
    k, command = memory.k, memory.command.path
    Ki, w = gain_for(k, settings, sample.dt_s)
    Ki = requested_gain_share(gains, R, settings) * Ki
    is_measured = k >= settings.softest_N_m
    own_kg = INERTIA_SHARE * settings.inertia_kg * is_measured
    foreseen_N = (
        sample.force_N
        + R @ (own_kg * (R.T @ command.acceleration))
        - R @ (w * k * (R.T @ (command.command - command.felt)))
    )
    drift_m_s = None
    if not settings.tracks or sample.mode == "orientation" or not is_measured[2]:
        memory = replace(memory, follow=NOT_TRACKING)  # an old surface estimate is useless later
    else:
        felt = _press_axis(memory, R[:, 2], settings)
        follow = followed(memory.follow, felt, sample, Ki=float(Ki[2]), tau_s=settings.tau_s)
        memory = replace(memory, follow=follow)
        ahead_s = settings.tau_s - sample.dt_s
        share = follow.share * noise_weight(follow.drift.speed_m_s, felt.k_N_m * settings.tau_s)
        ahead_m = share * follow.drift.ahead_m(ahead_s, follow.calm)
        foreseen_N = foreseen_N + w[2] * k[2] * ahead_m * R[:, 2]
        speed_m_s = share * follow.drift.speed_in_m_s(ahead_s, follow.calm)
        drift_m_s = (speed_m_s + follow.trim_m_s) * R[:, 2]
    error_N = R.T @ foreseen_N + np.array([0.0, 0.0, sample.setpoint_N])
    Ki = limit_gain_for_braking(Ki, error_N, k, settings.heat.brake_m_s2)
    richer = replace(sample, foreseen_N=foreseen_N, drift_m_s=drift_m_s, R_base_gains=R)
    band = DEADBAND_IN_CONTACT if memory.free_s == 0.0 else 1.0
    tuned = replace(gains, force_i_m_per_Ns=Ki)
    plain = replace(
        plain, deadband_N=band * plain.deadband_N, accel_max_m_s2=settings.heat.accel_m_s2
    )
    return step(law, richer, tuned, plain), memory


def requested_gain_share(gains: PiGains, R: Array, settings: AdaptiveSettings) -> Array:
    """Return requested gain over rule gain along the tool's axes, at most 1. Shape (3,)."""
    return np.minimum((R * R).T @ gains.force_i_m_per_Ns / settings.plain_gain_m_per_Ns, 1.0)


def plain_gain(memory: AdaptiveState, settings: AdaptiveSettings) -> Array:
    """Return the gain rule's integral gains for the estimated stiffness, tool axes [m/(N s)]."""
    Ki = LOOP_GAIN / (memory.k * settings.tau_s)
    return np.minimum(Ki, settings.plain_cap_m_per_Ns)


def update_estimates(
    law: LawState,
    memory: AdaptiveState,
    sample: LawInput,
    *,
    T_measured: pin.SE3,
    settings: AdaptiveSettings,
) -> AdaptiveState:
    """Return the state with the stiffness and response estimates updated by this sample.

    While a moving surface is tracked, travel without force carries no stiffness information.
    """
    path = settings.path
    command = ways.update_commanded(memory.command, law, sample.dt_s, path)
    measured = ways.update_measured(memory.measured, law, T_measured, sample=sample, settings=path)
    memory = replace(memory, command=command, measured=measured)
    R = law.T_base_tcp.rotation
    touches = length(sample.force_N) > settings.touch_N
    if not touches:
        free_s = memory.free_s + sample.dt_s
        if free_s <= FREE_TAUS * settings.tau_s:
            return replace(memory, free_s=free_s)
        forgotten = replace(memory, response=response.unheard(), follow=NOT_TRACKING, free_s=free_s)
        return replace(forgotten, stiffness=stiff.stiffest(settings.stiffness))
    own_N = IDENTIFICATION_INERTIA_SHARE * settings.inertia_kg * command.path.acceleration
    force_N = R.T @ (sample.force_N + own_N)
    state = memory.stiffness
    if measured.is_new:
        state = stiff.feel(
            state,
            measured.way.felt_m,
            force_N,
            dt_s=measured.took_s,
            settings=settings.stiffness,
            may_soften=not memory.follow.near,
        )
    memory = replace(memory, stiffness=state, free_s=0.0)
    if memory.follow.near:
        return memory
    known = settings.stiffness
    heard = ResponseSample(
        command.felt_m,
        R.T @ command.path.speed,
        force_N,
        dt_s=sample.dt_s,
        memory_s=known.memory_s,
        noise_N=known.noise,
        least_way_m=known.way,
    )
    return replace(memory, response=response.hear(memory.response, heard, state.k))


def gain_for(k: Array, settings: AdaptiveSettings, dt_s: float) -> tuple[Array, Array]:
    """Return integral gain and prediction weight along each axis. Shapes (3,).

    Half the sample period is part of the loop delay, so a late sample lowers the gain; a slow loop
    tolerates less inertia compensation and less prediction.
    """
    tau_s = settings.tau_s + 0.5 * (dt_s - settings.period_s)
    margin = float(np.interp(dt_s, LOOPS_S, SURE_INERTIA_MARGIN))
    bears = float(np.interp(dt_s, LOOPS_S, (1.0, 0.0)))
    heat = settings.heat
    loop = LOOP_GAIN + (heat.loop - LOOP_GAIN) * (bears if settings.predicts else 0.0)
    Ki = np.minimum(loop / (k * tau_s), margin * settings.inertia_cap_m_per_Ns)
    fades = max(bears, LEAST_FADE) * (heat.foreseen_loop - LOOP_GAIN)
    hot = (k * Ki * tau_s - LOOP_GAIN) / fades
    w = np.clip(hot, 0.0, heat.most_foreseen)
    is_measured = k >= settings.softest_N_m
    slow = np.minimum(Ki, settings.plain_gain_m_per_Ns)
    return np.where(is_measured, Ki, slow), np.where(is_measured, w, 0.0)


def _press_axis(memory: AdaptiveState, axis: Array, settings: AdaptiveSettings) -> PressAxisState:
    command = memory.command.path
    coming_m = command.command - command.felt
    return PressAxisState(
        axis=axis,
        k_N_m=float(memory.k[2]),
        is_known=bool(memory.stiffness.known[2]),
        way_m=float(memory.command.felt_m[2]),
        coming_m=float(axis @ coming_m),
        own_N=INERTIA_SHARE * settings.inertia_kg * float(axis @ command.acceleration),
        touches=memory.free_s == 0.0,
    )
