"""Adaptive law: PI law with gain scheduling, Smith predictor and surface feed-forward. Pure.

Along each axis of the tool, with k the estimated contact stiffness and tau the loop delay:

    Ki  = min(c / (k tau), 1.5 / (m w_b))  c: 0.45 to 3.4 with the prediction w
    F'  = F + 0.7 m a - w k (x_command - x_filtered)  force once all commands have arrived
    v   = Ki (F' - F_set) + v_surface                 v_surface: press axis only

F' is a Smith predictor (O. J. M. Smith, Closer control of loops with dead time, 1957). x_filtered
is the command passed through the delay model up to the filtered force (`delay_model.py`). k is
identified from the measured pose and reduced by the arm's own compliance (`estimates.py`). The
weight w of the prediction grows with the gain: where inertia caps the gain there is little to
predict, and a slow loop tolerates less gain and less inertia compensation. w stays below one,
because k is an upper bound: a prediction 10 % too large costs another round trip, one 10 % too
small a few per cent of overshoot. Surface tracking starts once the force has been near its set
point.

c is scheduled on `rates.robot_hz`: a controller that reports rarely also executes poses rarely,
each with its own delay, and deviates more from the delay model. The predictor requires that
commands are executed unchanged, so the law accelerates and brakes no faster than the arm may.
"""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array, apart, length
from services.regulator import surface_tracking
from services.regulator.delay_model import ContactTravel, DelayModelSettings
from services.regulator.estimates import FitSettings, ResponseShare, Stiffness
from services.regulator.gains import PiGains
from services.regulator.law import LawInput, LawMotion, LawSettings, next_motion
from services.regulator.surface_tracking import NOT_TRACKING, SurfaceTracking
from tuning.gain_rule import INERTIA_MARGIN, LOOP_GAIN, tune
from tuning.measured_range import softest_N_m

INERTIA_SHARE = 0.7  # share of the tool's inertial force removed from the control error
IDENTIFICATION_INERTIA_SHARE = 0.9  # the same share for identification: it closes no loop
SURE_INERTIA_MARGIN = (1.5, 0.4)  # of 1 / (m w_b), in a fast loop and a slow one
LOOPS_S = (0.008, 0.016)  # loop periods with full prediction and with none
LEAST_FADE = 0.05  # least share of the gain range over which the prediction fades in, slowest loop
ROBOT_PERIODS_S = (0.010, 0.025)  # of the rows of gain limits
LOOP = (3.4, 2.0)
FULL_PREDICTION_LOOP = (2.5, 2.0)
LARGEST_PREDICTION_WEIGHT = (0.9, 1.0)
ACCEL_SHARE = 0.95  # of the cell's limit: the arbiter must not have to limit the command
BRAKE_SHARE = 0.8  # of the cell's limit: the rest is margin for disturbances
LEAST_GAIN_M_PER_NS = 1e-9  # a request may set the gain to zero
LEAST_ERROR_N, LEAST_SHARE = 1e-9, 0.1  # least share of the braking per axis

MEMORY_TAUS, MEMORY_PERIODS, MEMORY_LEAST_S = 2.0, 10.0, 0.1  # forgetting of the identification
NOISE_N = 0.08
TOUCH_SHARE = 0.5  # of the touch force: below it there is no contact
FREE_TAUS = 3.0  # time without contact after which the estimates are reset
DEADBAND_IN_CONTACT = 0.25  # of the deadband, which serves against drift in free space
VALID_WITHIN_M, VALID_WITHIN_RAD = 0.002, 0.05  # an identified stiffness is valid this close by


@dataclass(frozen=True, slots=True)
class AdaptiveSettings:
    """Constants of the adaptive law for one cell."""

    plain: LawSettings  # of the PI law inside
    tau_s: float
    delay_model: DelayModelSettings
    wrench_filter: DelayModelSettings  # from the measured pose to the filtered force
    stiffness: FitSettings
    period_s: float  # nominal: tau holds half of it
    inertia_cap_m_per_Ns: float  # 1 / (m w_b), before its margin
    plain_gain_m_per_Ns: float  # of the gain rule: requested gains below it reduce the gain
    inertia_kg: float
    touch_N: float
    loop: float  # k Ki tau at most
    full_prediction_loop: float  # k Ki tau from which the prediction has its full weight
    largest_prediction_weight: float
    brake_m_s2: float
    softest_N_m: float  # below it the plain law's gain holds: see measured_range.py
    tracks: bool

    @classmethod
    def of(cls, cell: CellConfig) -> "AdaptiveSettings":
        """Return the constants of a cell."""
        tau_s, contact, rates = cell.loop_delay_s, cell.contact, cell.rates
        slower_hz = min(rates.control_hz, rates.robot_hz)
        memory_s = max(MEMORY_TAUS * tau_s, MEMORY_PERIODS / slower_hz, MEMORY_LEAST_S)
        m_w_b = contact.inertia_kg * cell.robot.bandwidth_rad_s
        loop, full_prediction_loop, largest_prediction_weight = (
            float(np.interp(1.0 / rates.robot_hz, ROBOT_PERIODS_S, row))
            for row in (LOOP, FULL_PREDICTION_LOOP, LARGEST_PREDICTION_WEIGHT)
        )
        return cls(
            plain=replace(
                LawSettings.of(cell), accel_max_m_s2=ACCEL_SHARE * cell.limits.accel_m_s2
            ),
            tau_s=tau_s,
            period_s=1.0 / rates.control_hz,
            delay_model=DelayModelSettings.of(cell),
            wrench_filter=DelayModelSettings.of_wrench(cell),
            stiffness=FitSettings(contact.stiffness_N_m, memory_s, NOISE_N),
            inertia_cap_m_per_Ns=1.0 / m_w_b,
            plain_gain_m_per_Ns=tune(cell).force_i_m_per_Ns,
            inertia_kg=contact.inertia_kg,
            touch_N=TOUCH_SHARE * cell.force.touch_N,
            loop=loop if cell.force.delay_compensation else LOOP_GAIN,
            full_prediction_loop=full_prediction_loop,
            largest_prediction_weight=largest_prediction_weight,
            brake_m_s2=BRAKE_SHARE * cell.limits.accel_m_s2,
            softest_N_m=softest_N_m(cell) or 0.0,
            tracks=cell.force.surface_tracking,
        )


@dataclass(frozen=True, slots=True)
class AdaptiveState:
    """State of the adaptive law. Travel is of the contact point, estimates are in tool axes."""

    command: ContactTravel
    measured: ContactTravel
    stiffness: Stiffness
    response: ResponseShare
    since_report_s: float = 0.0  # since the last pose report
    tracking: SurfaceTracking = NOT_TRACKING
    free_s: float = 0.0  # time without contact

    @property
    def k(self) -> Array:
        """Stiffness as seen by the commands [N/m]. Shape (3,)."""
        return self.response.share * self.stiffness.k


@dataclass(frozen=True, slots=True)
class ContactStiffness:
    """Contact stiffness identified last, with its pose: valid after a stop and a start in place."""

    k: Array  # shape (3,), tool axes
    T_base_tcp: pin.SE3
    touch_N: float  # contact force below which it is no longer valid

    def at_pose(self, T_base_tcp: pin.SE3) -> Array | None:
        """Return the stiffness if it is valid at a pose, None elsewhere."""
        distance_m, turn_rad = apart(self.T_base_tcp, T_base_tcp)
        is_valid = distance_m <= VALID_WITHIN_M and turn_rad <= VALID_WITHIN_RAD
        return self.k if is_valid else None


def begin(
    T_command: pin.SE3, T_measured: pin.SE3, k: Array | None, settings: AdaptiveSettings
) -> AdaptiveState:
    """Return the state of a tool at rest; `k`: stiffness identified here before. Shape (3,)."""
    return AdaptiveState(
        ContactTravel.at_rest(T_command),
        ContactTravel.at_rest(T_measured),
        Stiffness.stiffest(settings.stiffness) if k is None else Stiffness.known(k),
        ResponseShare.rigid(),
    )


def identified(state: AdaptiveState, settings: AdaptiveSettings) -> ContactStiffness | None:
    """Return the stiffness that a session identified; None out of contact or if it did not."""
    if state.free_s > 0.0 or not state.stiffness.identified[2]:
        return None
    return ContactStiffness(state.stiffness.k, state.measured.T_base_tcp, settings.touch_N)


def step(
    state: AdaptiveState, sample: LawInput, settings: AdaptiveSettings
) -> tuple[AdaptiveState, LawMotion]:
    """Return the next state, and the motion of the PI law with adapted gains and forces.

    Requested force integral gains below the gain rule's reduce this law's gain.
    """
    R = sample.motion.T_base_tcp.rotation
    state = update_estimates(state, sample, settings)
    k, command = state.k, state.command.delay_model
    Ki, w = gain_for(k, settings, sample.dt_s)
    Ki = requested_gain_share(sample.gains, R, settings) * Ki
    is_measured = k >= settings.softest_N_m
    compensated_kg = INERTIA_SHARE * settings.inertia_kg * is_measured
    in_flight_m = R.T @ (command.command - command.filtered)
    acceleration = R.T @ command.acceleration
    predicted_N = R.T @ sample.force_N + compensated_kg * acceleration - w * k * in_flight_m
    tracking, drift_m_s = NOT_TRACKING, 0.0  # an old estimate is useless later
    if settings.tracks and sample.mode != "orientation" and is_measured[2]:
        tracking, ahead_m, drift_m_s = surface_tracking.update(
            state.tracking,
            sample,
            k_N_m=float(k[2]),
            may_begin=bool(state.stiffness.identified[2]),
            in_contact=state.free_s == 0.0,
            filtered_travel_m=float(state.command.filtered_travel_m[2]),
            in_flight_m=float(in_flight_m[2]),
            inertial_N=INERTIA_SHARE * settings.inertia_kg * float(acceleration[2]),
            Ki=float(Ki[2]),
            tau_s=settings.tau_s,
        )
        predicted_N[2] += w[2] * k[2] * ahead_m
    error_N = predicted_N + np.array([0.0, 0.0, sample.setpoint_N])
    Ki = limit_gain_for_braking(Ki, error_N, k, settings.brake_m_s2)
    extended = replace(
        sample,
        predicted_N=R @ predicted_N,
        drift_m_s=drift_m_s * R[:, 2],
        R_base_gains=R,
        gains=replace(sample.gains, force_i_m_per_Ns=Ki),
    )
    band = DEADBAND_IN_CONTACT if state.free_s == 0.0 else 1.0
    plain = replace(settings.plain, deadband_N=band * settings.plain.deadband_N)
    motion = replace(next_motion(extended, plain), follows=tracking.near)
    return replace(state, tracking=tracking), motion


def requested_gain_share(gains: PiGains, R: Array, settings: AdaptiveSettings) -> Array:
    """Return requested gain over rule gain along the tool's axes, at most 1. Shape (3,)."""
    return np.minimum((R * R).T @ gains.force_i_m_per_Ns / settings.plain_gain_m_per_Ns, 1.0)


def controller_gain(
    state: AdaptiveState, gains: PiGains, R_base_tcp: Array, settings: AdaptiveSettings
) -> Array:
    """Return the integral gains of the host controller, base axes [m/(N s)]. Shape (3,).

    The controller has neither predictor nor inertia compensation, so the plain gain rule applies,
    to the estimated stiffness.
    """
    cap_m_per_Ns = INERTIA_MARGIN * settings.inertia_cap_m_per_Ns
    Ki = np.minimum(LOOP_GAIN / (state.k * settings.tau_s), cap_m_per_Ns)
    Ki = requested_gain_share(gains, R_base_tcp, settings) * Ki
    return np.asarray((R_base_tcp * R_base_tcp) @ Ki)


def update_estimates(
    state: AdaptiveState, sample: LawInput, settings: AdaptiveSettings
) -> AdaptiveState:
    """Return the state with the stiffness and response estimates updated by this sample.

    Between two reports the measured pose is older than the force: paired with it, a stiff contact
    would look soft. So each report counts once. While a moving surface is tracked, travel without
    force carries no stiffness information.
    """
    motion, dt_s, fit = sample.motion, sample.dt_s, settings.stiffness
    command = state.command.to(motion.T_base_tcp, motion, dt_s, settings.delay_model)
    measured, report_s = state.measured, state.since_report_s + dt_s
    if sample.pose_is_new:
        measured = measured.to(sample.T_measured, motion, report_s, settings.wrench_filter)
    since_report_s = 0.0 if sample.pose_is_new else report_s
    state = replace(state, command=command, measured=measured, since_report_s=since_report_s)
    if length(sample.force_N) <= settings.touch_N:
        free_s = state.free_s + dt_s
        if free_s > FREE_TAUS * settings.tau_s:
            state = replace(
                state,
                stiffness=Stiffness.stiffest(fit),
                response=ResponseShare.rigid(),
                tracking=NOT_TRACKING,
            )
        return replace(state, free_s=free_s)
    model, R = command.delay_model, motion.T_base_tcp.rotation
    inertia_kg = IDENTIFICATION_INERTIA_SHARE * settings.inertia_kg
    force_N = R.T @ (sample.force_N + inertia_kg * model.acceleration)
    stiffness, response, tracks = state.stiffness, state.response, state.tracking.near
    if sample.pose_is_new:
        travel_m = measured.filtered_travel_m
        stiffness = stiffness.after(
            travel_m, force_N, dt_s=report_s, settings=fit, may_soften=not tracks
        )
    if not tracks:
        values = command.filtered_travel_m, R.T @ model.speed, force_N
        response = response.after(values, stiffness.k, dt_s=dt_s, settings=fit)
    return replace(state, stiffness=stiffness, response=response, free_s=0.0)


def gain_for(k: Array, settings: AdaptiveSettings, dt_s: float) -> tuple[Array, Array]:
    """Return integral gain and prediction weight along each axis. Shapes (3,).

    Half the sample period is part of the loop delay, so a late sample lowers the gain; a slow loop
    tolerates less inertia compensation and less prediction.
    """
    tau_s = settings.tau_s + 0.5 * (dt_s - settings.period_s)
    margin = float(np.interp(dt_s, LOOPS_S, SURE_INERTIA_MARGIN))
    loop_share = float(np.interp(dt_s, LOOPS_S, (1.0, 0.0)))
    loop = LOOP_GAIN + (settings.loop - LOOP_GAIN) * loop_share
    Ki = np.minimum(loop / (k * tau_s), margin * settings.inertia_cap_m_per_Ns)
    fade_range = max(loop_share, LEAST_FADE) * (settings.full_prediction_loop - LOOP_GAIN)
    share = (k * Ki * tau_s - LOOP_GAIN) / fade_range
    w = np.clip(share, 0.0, settings.largest_prediction_weight)
    is_measured = k >= settings.softest_N_m
    slow = np.minimum(Ki, settings.plain_gain_m_per_Ns)
    return np.where(is_measured, Ki, slow), np.where(is_measured, w, 0.0)


def limit_gain_for_braking(Ki: Array, error_N: Array, k: Array, brake_m_s2: float) -> Array:
    """Return the gain along each axis with which the arm still comes to rest in time.

    The arm brakes with a at most. For large errors the speed therefore follows the square root of
    the error, as in proximate time-optimal servo control: the arm comes to rest just as the force
    reaches its set point. Where the linear law

        v = Ki e,   dv/dt = -k Ki v

    needs no more than a, at errors up to e_1 = a / (k Ki^2), it is used as it is; beyond,

        v = sqrt(2 a (e - e_1 / 2) / k)

    which joins it with equal value and slope. Axes share a in proportion to their errors.

    Args:
        Ki: Integral gain of the linear law [m/(N s)]. Shape (3,), as the others.
        error_N: Predicted force minus the set point.
        k: Stiffness [N/m].
        brake_m_s2: Deceleration of the arm.
    """
    size_N = max(length(error_N), LEAST_ERROR_N)
    brakes_m_s2 = brake_m_s2 * np.maximum(np.abs(error_N) / size_N, LEAST_SHARE)
    linear_N = brakes_m_s2 / (k * np.maximum(Ki, LEAST_GAIN_M_PER_NS) ** 2)
    error = np.maximum(np.abs(error_N), linear_N)
    speed_m_s = np.sqrt(2.0 * brakes_m_s2 * (error - 0.5 * linear_N) / k)
    return np.asarray(np.minimum(Ki, speed_m_s / error))
