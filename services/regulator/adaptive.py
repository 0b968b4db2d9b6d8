"""Adaptive law: PI law with gain scheduling, Smith predictor and surface feed-forward. Pure.

Along each axis of the tool, with k the estimated contact stiffness and tau the loop delay:

    Ki  = min(c / (k tau), 1.5 / (m w_b))  c: 0.45 to 3.4 with the prediction w; gain_schedule.py
    F'  = F + 0.7 m a - w k (x_command - x_filtered)  force once all commands have arrived
    v   = Ki (F' - F_set) + v_surface                 v_surface: press axis only

F' is a Smith predictor (O. J. M. Smith, Closer control of loops with dead time, 1957). x_filtered
is the command passed through the delay model up to the filtered force (`delay_model.py`). k is
identified from the measured pose (`stiffness.py`) and reduced by the arm's own compliance
(`response.py`). The weight w of the prediction grows with the gain: where inertia caps the gain
there is little to
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
from services.regulator import contact_travel, response, stiffness, surface_tracking
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
    noise_weight,
)
from tuning.adaptive_map import softest_N_m
from tuning.gain_rule import INERTIA_MARGIN, LOOP_GAIN, tune

INERTIA_SHARE = 0.7  # share of the tool's inertial force removed from the control error
IDENTIFICATION_INERTIA_SHARE = 0.9  # the same share for identification: it closes no loop
SURE_INERTIA_MARGIN = (1.5, 0.4)  # of 1 / (m w_b), in a fast loop and a slow one
LOOPS_S = (0.008, 0.016)  # loop periods with full prediction and with none
LEAST_FADE = 0.05  # least share of the gain range over which the prediction fades in, slowest loop

MEMORY_TAUS, MEMORY_PERIODS, MEMORY_LEAST_S = 2.0, 10.0, 0.1  # forgetting of the identification
STIFFER = 1.0  # initial estimate, relative to the stiffest contact of the cell
NOISE_N, LEAST_TRAVEL_M, SOFTEST_N_M = 0.08, 1e-5, 200.0
TOUCH_SHARE = 0.5  # of the touch force: below it there is no contact
FREE_TAUS = 3.0  # time without contact after which the estimates are reset
DEADBAND_IN_CONTACT = 0.25  # of the deadband, which serves against drift in free space


@dataclass(frozen=True, slots=True)
class AdaptiveSettings:
    """Constants of the adaptive law for one cell."""

    tau_s: float
    delay_model: DelayModelSettings
    stiffness: StiffnessSettings
    period_s: float  # nominal: tau holds half of it
    inertia_cap_m_per_Ns: float  # 1 / (m w_b), before its margin
    plain_cap_m_per_Ns: float  # of the gain rule: the plain law compensates no inertia
    plain_gain_m_per_Ns: float  # of the gain rule: requested gains below it reduce the gain
    inertia_kg: float
    touch_N: float
    gain_limits: GainLimits
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
            delay_model=DelayModelSettings.of(cell),
            stiffness=StiffnessSettings(
                STIFFER * contact.stiffness_N_m, SOFTEST_N_M, memory_s, NOISE_N, LEAST_TRAVEL_M
            ),
            inertia_cap_m_per_Ns=1.0 / m_w_b,
            plain_cap_m_per_Ns=INERTIA_MARGIN / m_w_b,
            plain_gain_m_per_Ns=tune(cell).force_i_m_per_Ns,
            inertia_kg=contact.inertia_kg,
            touch_N=TOUCH_SHARE * cell.force.touch_N,
            gain_limits=gain_limits_of(cell),
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
    tracking: SurfaceTracking = NOT_TRACKING
    free_s: float = 0.0  # time without contact

    @property
    def k(self) -> Array:
        """Stiffness along the tool's axes as seen by the commands [N/m]. Shape (3,)."""
        return self.response.share * self.stiffness.k


def begin(
    T_command: pin.SE3, T_measured: pin.SE3, settings: AdaptiveSettings, k: Array | None = None
) -> AdaptiveState:
    """Return the state of a tool at rest; `k`: stiffness identified here before. Shape (3,)."""
    state = stiffness.stiffest(settings.stiffness) if k is None else stiffness.initial(k)
    command, measured = (
        contact_travel.begin(T_command),
        MeasuredTravel(contact_travel.begin(T_measured)),
    )
    return AdaptiveState(command, measured, state, response.initial())


def advance(
    law: LawState,
    adaptive: AdaptiveState,
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
        adaptive: State of the adaptive law.
        sample: Wrench and targets of this period.
        T_measured: Pose of the TCP, in base.
        gains: Of the PI law; force integral gains below the gain rule's reduce this law's gain.
        plain: Settings of the PI law.
        settings: Settings of this law.
    """
    R = law.T_base_tcp.rotation
    adaptive = update_estimates(law, adaptive, sample, T_measured=T_measured, settings=settings)
    k, command = adaptive.k, adaptive.command.delay_model
    Ki, w = gain_for(k, settings, sample.dt_s)
    Ki = requested_gain_share(gains, R, settings) * Ki
    is_measured = k >= settings.softest_N_m
    compensated_kg = INERTIA_SHARE * settings.inertia_kg * is_measured
    predicted_N = (
        sample.force_N
        + R @ (compensated_kg * (R.T @ command.acceleration))
        - R @ (w * k * (R.T @ (command.command - command.filtered)))
    )
    drift_m_s = None
    if not settings.tracks or sample.mode == "orientation" or not is_measured[2]:
        adaptive = replace(adaptive, tracking=NOT_TRACKING)  # an old estimate is useless later
    else:
        press_axis = _press_axis(adaptive, R[:, 2], settings)
        tracking = surface_tracking.update(
            adaptive.tracking, press_axis, sample, Ki=float(Ki[2]), tau_s=settings.tau_s
        )
        adaptive = replace(adaptive, tracking=tracking)
        ahead_s = settings.tau_s - sample.dt_s
        share = tracking.share * noise_weight(
            tracking.drift.speed_m_s, press_axis.k_N_m * settings.tau_s
        )
        ahead_m = share * tracking.drift.ahead_m(ahead_s, tracking.steadiness)
        predicted_N = predicted_N + w[2] * k[2] * ahead_m * R[:, 2]
        speed_m_s = share * tracking.drift.speed_in_m_s(ahead_s, tracking.steadiness)
        drift_m_s = (speed_m_s + tracking.trim_m_s) * R[:, 2]
    error_N = R.T @ predicted_N + np.array([0.0, 0.0, sample.setpoint_N])
    Ki = limit_gain_for_braking(Ki, error_N, k, settings.gain_limits.brake_m_s2)
    extended = replace(sample, predicted_N=predicted_N, drift_m_s=drift_m_s, R_base_gains=R)
    band = DEADBAND_IN_CONTACT if adaptive.free_s == 0.0 else 1.0
    tuned = replace(gains, force_i_m_per_Ns=Ki)
    plain = replace(
        plain, deadband_N=band * plain.deadband_N, accel_max_m_s2=settings.gain_limits.accel_m_s2
    )
    return step(law, extended, tuned, plain), adaptive


def requested_gain_share(gains: PiGains, R: Array, settings: AdaptiveSettings) -> Array:
    """Return requested gain over rule gain along the tool's axes, at most 1. Shape (3,)."""
    return np.minimum((R * R).T @ gains.force_i_m_per_Ns / settings.plain_gain_m_per_Ns, 1.0)


def plain_gain(adaptive: AdaptiveState, settings: AdaptiveSettings) -> Array:
    """Return the gain rule's integral gains for the estimated stiffness, tool axes [m/(N s)]."""
    Ki = LOOP_GAIN / (adaptive.k * settings.tau_s)
    return np.minimum(Ki, settings.plain_cap_m_per_Ns)


def update_estimates(
    law: LawState,
    adaptive: AdaptiveState,
    sample: LawInput,
    *,
    T_measured: pin.SE3,
    settings: AdaptiveSettings,
) -> AdaptiveState:
    """Return the state with the stiffness and response estimates updated by this sample.

    While a moving surface is tracked, travel without force carries no stiffness information.
    """
    delay = settings.delay_model
    command = contact_travel.update_commanded(adaptive.command, law, sample.dt_s, delay)
    measured = contact_travel.update_measured(
        adaptive.measured, law, T_measured, sample=sample, settings=delay
    )
    adaptive = replace(adaptive, command=command, measured=measured)
    R = law.T_base_tcp.rotation
    in_contact = length(sample.force_N) > settings.touch_N
    if not in_contact:
        free_s = adaptive.free_s + sample.dt_s
        if free_s <= FREE_TAUS * settings.tau_s:
            return replace(adaptive, free_s=free_s)
        reset = replace(adaptive, response=response.initial(), tracking=NOT_TRACKING, free_s=free_s)
        return replace(reset, stiffness=stiffness.stiffest(settings.stiffness))
    inertial_N = (
        IDENTIFICATION_INERTIA_SHARE * settings.inertia_kg * command.delay_model.acceleration
    )
    force_N = R.T @ (sample.force_N + inertial_N)
    state = adaptive.stiffness
    if measured.is_new:
        state = stiffness.update(
            state,
            measured.travel.filtered_travel_m,
            force_N,
            dt_s=measured.report_period_s,
            settings=settings.stiffness,
            may_soften=not adaptive.tracking.near,
        )
    adaptive = replace(adaptive, stiffness=state, free_s=0.0)
    if adaptive.tracking.near:
        return adaptive
    fit = settings.stiffness
    response_sample = ResponseSample(
        command.filtered_travel_m,
        R.T @ command.delay_model.speed,
        force_N,
        dt_s=sample.dt_s,
        memory_s=fit.memory_s,
        noise_N=fit.noise,
        least_travel_m=fit.least_travel,
    )
    return replace(adaptive, response=response.update(adaptive.response, response_sample, state.k))


def gain_for(k: Array, settings: AdaptiveSettings, dt_s: float) -> tuple[Array, Array]:
    """Return integral gain and prediction weight along each axis. Shapes (3,).

    Half the sample period is part of the loop delay, so a late sample lowers the gain; a slow loop
    tolerates less inertia compensation and less prediction.
    """
    tau_s = settings.tau_s + 0.5 * (dt_s - settings.period_s)
    margin = float(np.interp(dt_s, LOOPS_S, SURE_INERTIA_MARGIN))
    loop_share = float(np.interp(dt_s, LOOPS_S, (1.0, 0.0)))
    limits = settings.gain_limits
    loop = LOOP_GAIN + (limits.loop - LOOP_GAIN) * (loop_share if settings.predicts else 0.0)
    Ki = np.minimum(loop / (k * tau_s), margin * settings.inertia_cap_m_per_Ns)
    fade_range = max(loop_share, LEAST_FADE) * (limits.full_prediction_loop - LOOP_GAIN)
    share = (k * Ki * tau_s - LOOP_GAIN) / fade_range
    w = np.clip(share, 0.0, limits.largest_prediction_weight)
    is_measured = k >= settings.softest_N_m
    slow = np.minimum(Ki, settings.plain_gain_m_per_Ns)
    return np.where(is_measured, Ki, slow), np.where(is_measured, w, 0.0)


def _press_axis(adaptive: AdaptiveState, axis: Array, settings: AdaptiveSettings) -> PressAxisState:
    command = adaptive.command.delay_model
    in_flight_m = command.command - command.filtered
    return PressAxisState(
        axis=axis,
        k_N_m=float(adaptive.k[2]),
        is_identified=bool(adaptive.stiffness.identified[2]),
        filtered_travel_m=float(adaptive.command.filtered_travel_m[2]),
        in_flight_m=float(axis @ in_flight_m),
        inertial_N=INERTIA_SHARE * settings.inertia_kg * float(axis @ command.acceleration),
        in_contact=adaptive.free_s == 0.0,
    )
