"""Adaptive law: PI law with gain scheduling, Smith predictor and surface feed-forward. Pure.

Along each axis of the task frame, with k the estimated contact stiffness and tau the loop delay:

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
commands are executed unchanged, so force control accelerates and brakes no faster than the arm may.
"""

from dataclasses import dataclass, field, replace
from math import hypot, sqrt

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.config.plant import Delays
from common.motion.frames import Rows, Vector, apart, plus, product, rotated, rotated_back, scaled
from control.axis_task import IDENTITY
from control.delay_model import ContactTravel
from control.estimates import FitSettings, ResponseShare, Stiffness
from control.gain_rule import INERTIA_MARGIN, LOOP_GAIN, tune
from control.law import LawInput, LawMotion, LawSettings, next_motion, task_deadband
from control.measured_range import softest_N_m
from control.surface_tracking import SurfaceTracking
from forcemesh.messages import Gains, Vec3

INERTIA_SHARE = 0.7  # share of the tool's inertial force removed from the control error
IDENTIFICATION_INERTIA_SHARE = 0.9  # the same share for identification: it closes no loop
SURE_INERTIA_MARGIN = (1.5, 0.4)  # of 1 / (m w_b), in a fast loop and a slow one
FAST_LOOP_S, SLOW_LOOP_S = 0.008, 0.016  # loop periods with full prediction and with none
UNPREDICTED_AT = 0.2  # fall of the gain share at which nothing is predicted any more
LEAST_FADE = 0.05  # least share of the gain range over which the prediction fades in, slowest loop
ROBOT_PERIODS_S = (0.010, 0.025)  # of the rows of gain limits
LOOP = (3.4, 2.0)
FULL_PREDICTION_LOOP = (2.5, 2.0)
LARGEST_PREDICTION_WEIGHT = (0.9, 1.0)
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

    plain: LawSettings  # of the PI law inside, in free space
    in_contact: LawSettings
    rounding_m: float  # of set points: within that the force cannot be controlled
    tau_s: float
    delay_model: Delays
    wrench_filter: Delays  # from the measured pose to the filtered force
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
        plant = cell.plant
        memory_s = plant.memory_s(MEMORY_TAUS, MEMORY_PERIODS, MEMORY_LEAST_S)
        loop, full_prediction_loop, largest_prediction_weight = (
            float(np.interp(1.0 / plant.robot_hz, ROBOT_PERIODS_S, row))
            for row in (LOOP, FULL_PREDICTION_LOOP, LARGEST_PREDICTION_WEIGHT)
        )
        plain = LawSettings.of(cell)
        return cls(
            plain=plain,
            in_contact=replace(plain, deadband_N=DEADBAND_IN_CONTACT * plain.deadband_N),
            rounding_m=plant.rounding_m,
            tau_s=plant.tau_s,
            period_s=1.0 / plant.control_hz,
            delay_model=plant.loop,
            wrench_filter=plant.wrench,
            stiffness=FitSettings(plant.stiffness_N_m, memory_s, NOISE_N),
            inertia_cap_m_per_Ns=1.0 / (plant.inertia_kg * plant.bandwidth_rad_s),
            plain_gain_m_per_Ns=tune(cell).force_i_m_per_Ns,
            inertia_kg=plant.inertia_kg,
            touch_N=TOUCH_SHARE * cell.force.touch_N,
            loop=loop if cell.force.delay_compensation else LOOP_GAIN,
            full_prediction_loop=full_prediction_loop,
            largest_prediction_weight=largest_prediction_weight,
            brake_m_s2=BRAKE_SHARE * cell.limits.accel_m_s2,
            softest_N_m=softest_N_m(cell) or 0.0,
            tracks=cell.force.surface_tracking,
        )


@dataclass(slots=True)
class AdaptiveState:
    """State of the adaptive law, advanced in place.

    Travel is of the contact point; estimates are along the three axes of the task frame.
    """

    command: ContactTravel
    measured: ContactTravel
    stiffness: list[Stiffness]
    response: list[ResponseShare]
    k_N_m: Vector  # as seen by the commands
    R_base_task: Rows = IDENTITY  # of the last sample
    press_index: int = 2  # axis of the task frame with the largest set point
    since_report_s: float = 0.0  # since the last pose report
    tracking: SurfaceTracking = field(default_factory=SurfaceTracking)
    free_s: float = 0.0  # time without contact


@dataclass(frozen=True, slots=True)
class ContactStiffness:
    """Contact stiffness identified last, with its pose: valid after a stop and a start in place."""

    k: Vector  # shape (3,), axes of the task frame
    T_base_tcp: pin.SE3  # of the TCP, with the axes of the task frame
    touch_N: float  # contact force below which it is no longer valid

    def at_pose(self, T_base_tcp: pin.SE3) -> Vector | None:
        """Return the stiffness if it is valid at a pose, None elsewhere."""
        distance_m, turn_rad = apart(self.T_base_tcp, T_base_tcp)
        is_valid = distance_m <= VALID_WITHIN_M and turn_rad <= VALID_WITHIN_RAD
        return self.k if is_valid else None


def begin(
    T_command: pin.SE3, T_measured: pin.SE3, k: Vector | None, settings: AdaptiveSettings
) -> AdaptiveState:
    """Return the state of a tool at rest; `k`: stiffness identified here before. Shape (3,)."""
    k_N_m = k or (settings.stiffness.stiffest_N_m,) * 3
    return AdaptiveState(
        ContactTravel(T_command.copy()),
        ContactTravel(T_measured.copy()),
        [Stiffness(axis_N_m, is_identified=k is not None) for axis_N_m in k_N_m],
        [ResponseShare() for _ in range(3)],
        k_N_m,
    )


def identified(state: AdaptiveState, settings: AdaptiveSettings) -> ContactStiffness | None:
    """Return the stiffness that a session identified; None out of contact or if it did not."""
    if state.free_s > 0.0 or not state.stiffness[state.press_index].is_identified:
        return None
    k = tuple(each.k_N_m for each in state.stiffness)
    T = pin.SE3(np.array(state.R_base_task), state.measured.T_base_tcp.translation)
    return ContactStiffness(k, T, settings.touch_N)


def step(
    state: AdaptiveState, sample: LawInput, settings: AdaptiveSettings
) -> tuple[AdaptiveState, LawMotion]:
    """Advance the state; return it, and the motion of the PI law with adapted gains and forces.

    Requested force integral gains below the gain rule's reduce this law's gain.
    """
    R_base_task = state.R_base_task = sample.R_base_task
    update_estimates(state, sample, settings)
    estimates = zip(state.response, state.stiffness, strict=True)
    k = state.k_N_m = [response.share * stiffness.k_N_m for response, stiffness in estimates]
    model, in_contact = state.command.delay_model, state.free_s == 0.0
    requested_Ki = rotated_back(squared(R_base_task), sample.gains.force_i_m_per_Ns)
    Ki, w = gain_for(k, requested_Ki, settings, sample.dt_s, share=sample.gain_share)
    in_flight_m = rotated_back(R_base_task, plus(model.command, model.filtered, -1.0))
    inertia_kg = INERTIA_SHARE * settings.inertia_kg
    inertial_N = rotated_back(R_base_task, scaled(model.acceleration, inertia_kg))
    force_N, drift_m_s = rotated_back(R_base_task, sample.force_N), 0.0
    error_N = [  # F' - F_set
        force + inertial * (stiffness >= settings.softest_N_m) - weight * stiffness * travel_m
        for force, inertial, weight, stiffness, travel_m in zip(
            force_N, inertial_N, w, k, in_flight_m, strict=True
        )
    ]
    axis = sample.task.press_index
    error_N = [*plus(error_N, sample.task.force_N)]
    if axis != state.press_index:
        state.tracking, state.press_index = SurfaceTracking(), axis
    if settings.tracks and sample.moves and k[axis] >= settings.softest_N_m:
        ahead_m, drift_m_s = state.tracking.update(
            force_N=force_N[axis],
            setpoint_N=sample.task.force_N[axis],
            dt_s=sample.dt_s,
            k_N_m=k[axis],
            may_begin=state.stiffness[axis].is_identified,
            in_contact=in_contact,
            filtered_travel_m=state.command.filtered_travel_m[axis],
            in_flight_m=in_flight_m[axis],
            inertial_N=inertial_N[axis],
            Ki=Ki[axis],
            tau_s=settings.tau_s,
        )
        error_N[axis] += w[axis] * k[axis] * ahead_m
    else:
        state.tracking = SurfaceTracking()  # an old estimate is useless later
    plain = settings.in_contact if in_contact else settings.plain
    Ki = limit_gain_for_braking(Ki, error_N, k, settings.brake_m_s2)
    rest_N = settings.rounding_m * max(k)
    beyond_N = task_deadband(error_N, plain.deadband_N, rest_N, sample.task.deadbands[0])
    speed_m_s = [*product(Ki, beyond_N)]
    speed_m_s[axis] += drift_m_s
    motion = next_motion(sample, plain, rotated(R_base_task, speed_m_s))
    motion.follows = state.tracking.near
    return state, motion


def controller_gain(
    state: AdaptiveState, gains: Gains, R_base_task: Rows, settings: AdaptiveSettings
) -> Vec3:
    """Return the integral gains of the host controller, base axes [m/(N s)]. Shape (3,).

    The controller has neither predictor nor inertia compensation, so the plain gain rule applies,
    to the estimated stiffness; below the softest one that was measured, to the cell's stiffest.
    """
    cap_m_per_Ns = INERTIA_MARGIN * settings.inertia_cap_m_per_Ns
    squares, rule = squared(R_base_task), settings.plain_gain_m_per_Ns
    requested_Ki = rotated_back(squares, gains.force_i_m_per_Ns)
    Ki = [
        min(LOOP_GAIN / (k * settings.tau_s), cap_m_per_Ns if k >= settings.softest_N_m else rule)
        * min(requested / rule, 1.0)
        for k, requested in zip(state.k_N_m, requested_Ki, strict=True)
    ]
    return rotated(squares, Ki)


def squared(R: Rows) -> Rows:
    """Return the squares of a rotation matrix: they turn a value along each axis, as a gain."""
    a, b, c = R
    return product(a, a), product(b, b), product(c, c)


def update_estimates(state: AdaptiveState, sample: LawInput, settings: AdaptiveSettings) -> None:
    """Update travel, stiffness and response estimates by this sample.

    Between two reports the measured pose is older than the force: paired with it, a stiff contact
    would look soft. So each report counts once. While a moving surface is tracked, travel without
    force carries no stiffness information. Nor does travel along an axis that is held, by a path or
    a turn: the force there is that of the motion along the others, and the contact would look soft.
    """
    motion, dt_s, fit = sample.motion, sample.dt_s, settings.stiffness
    command, report_s = state.command, state.since_report_s + dt_s
    command.follow(motion.T_base_tcp, sample, dt_s, settings.delay_model)
    state.since_report_s = report_s
    if sample.pose_is_new:
        state.measured.follow(sample.T_measured, sample, report_s, settings.wrench_filter)
        state.since_report_s = 0.0
    if hypot(*sample.force_N) <= settings.touch_N:
        state.free_s += dt_s
        if state.free_s > FREE_TAUS * settings.tau_s:
            fresh = begin(motion.T_base_tcp, sample.T_measured, None, settings)
            state.stiffness, state.response = fresh.stiffness, fresh.response
            state.tracking = fresh.tracking
        return
    state.free_s, model, tracks = 0.0, command.delay_model, state.tracking.near
    inertia_kg = IDENTIFICATION_INERTIA_SHARE * settings.inertia_kg
    R_base_task, travels_m = sample.R_base_task, state.measured.filtered_travel_m
    forces_N = rotated_back(R_base_task, plus(sample.force_N, model.acceleration, inertia_kg))
    speeds_m_s = rotated_back(R_base_task, model.speed)
    for axis, force_N in enumerate(forces_N):
        if not sample.task.force_along[axis]:
            continue
        stiffness = state.stiffness[axis]
        if sample.pose_is_new:
            stiffness.update(
                travels_m[axis], force_N, dt_s=report_s, settings=fit, may_soften=not tracks
            )
        if not tracks:
            values = command.filtered_travel_m[axis], speeds_m_s[axis], force_N
            state.response[axis].update(values, stiffness.k_N_m, dt_s=dt_s, settings=fit)


def gain_for(
    k: Vector,
    requested_Ki: Vector,
    settings: AdaptiveSettings,
    dt_s: float,
    *,
    share: float = 1.0,
) -> tuple[list[float], list[float]]:
    """Return integral gain and prediction weight along each axis of the tool. Shapes (3,).

    Half the sample period is part of the loop delay, so a late sample lowers the gain; a slow loop
    tolerates less inertia compensation and less prediction. A requested gain below the gain rule's
    reduces the gain by the same share. The gain share of the delay monitor, which the requested
    gains contain, does so too; and as the delay model is wrong then, prediction fades as in a slow
    loop.
    """
    tau_s = settings.tau_s + 0.5 * (dt_s - settings.period_s)
    slow = slowness(dt_s)
    faded = max(slow, min((1.0 - share) / UNPREDICTED_AT, 1.0))
    rule = settings.plain_gain_m_per_Ns
    Ki, w = [], []
    for k_N_m, requested in zip(k, requested_Ki, strict=True):
        gain, weight = _gain_at(k_N_m, settings, tau_s, faded)
        if faded > slow:  # a wrong delay model never permits more prediction
            weight = min(weight, _gain_at(k_N_m, settings, tau_s, slow)[1])
        if k_N_m < settings.softest_N_m:  # not measured: the plain law's gain, without prediction
            gain, weight = min(gain, rule), 0.0
        Ki.append(gain * share * min(requested / (rule * share), 1.0))
        w.append(weight)
    return Ki, w


def slowness(period_s: float) -> float:
    """Return 0 in a fast loop, 1 in a slow one, in which the adaptive law does not predict."""
    return min(max((period_s - FAST_LOOP_S) / (SLOW_LOOP_S - FAST_LOOP_S), 0.0), 1.0)


def sure_inertia_margin(slow: float) -> float:
    """Return the share of 1 / (m w_b) that the gain on an identified contact may reach."""
    fast_margin, slow_margin = SURE_INERTIA_MARGIN
    return fast_margin + (slow_margin - fast_margin) * slow


def _gain_at(
    k_N_m: float, settings: AdaptiveSettings, tau_s: float, slow: float
) -> tuple[float, float]:
    """Return gain and prediction weight of a loop, which is fast at 0 and slow at 1."""
    loop = LOOP_GAIN + (settings.loop - LOOP_GAIN) * (1.0 - slow)
    fade_range = max(1.0 - slow, LEAST_FADE) * (settings.full_prediction_loop - LOOP_GAIN)
    gain = min(loop / (k_N_m * tau_s), sure_inertia_margin(slow) * settings.inertia_cap_m_per_Ns)
    faded_in = (k_N_m * gain * tau_s - LOOP_GAIN) / fade_range
    return gain, min(max(faded_in, 0.0), settings.largest_prediction_weight)


def limit_gain_for_braking(
    Ki: Vector, error_N: Vector, k: Vector, brake_m_s2: float
) -> list[float]:
    """Return the gain along each axis with which the arm still comes to rest in time.

    The arm brakes with a at most. For large errors the speed therefore follows the square root of
    the error, as in proximate time-optimal servo control: the arm comes to rest just as the force
    reaches its set point. Where the linear law

        v = Ki e,   dv/dt = -k Ki v

    needs no more than a, at errors up to e_1 = a / (k Ki^2), it is used as it is; beyond,

        v = sqrt(2 a (e - e_1 / 2) / k)

    which joins it with equal value and slope. Axes share a in proportion to their errors.

    Args:
        Ki: Integral gain of the linear law [m/(N s)]. Shape (3,), as k and the error.
        error_N: Predicted force minus the set point.
        k: Stiffness [N/m].
        brake_m_s2: Deceleration of the arm.
    """
    size_N, limited = max(hypot(*error_N), LEAST_ERROR_N), []
    for gain, axis_error_N, k_N_m in zip(Ki, error_N, k, strict=True):
        brake = brake_m_s2 * max(abs(axis_error_N) / size_N, LEAST_SHARE)
        divisor = max(gain, LEAST_GAIN_M_PER_NS)
        linear_N = brake / (k_N_m * divisor * divisor)
        error = max(abs(axis_error_N), linear_N)
        speed_m_s = sqrt(2.0 * brake * (error - 0.5 * linear_N) / k_N_m)
        limited.append(min(gain, speed_m_s / error))
    return limited
