"""Recommended gains, their margins and cell file values, from the measurements. Pure."""

from dataclasses import asdict, dataclass
from math import ceil
from typing import Any

from common.config.cell import CellConfig
from control.gain_rule import INERTIA_MARGIN, equal_gains, rule_gain
from control.measured_range import range_violation, restriction
from forcemesh.messages import Gains, Host
from tuning.contact_response import ContactResponse
from tuning.contact_spring import Spring
from tuning.margins import Forecast, Loop, Margins, forecast, margins
from tuning.servo import Servo

LEAST_PHASE_DEG, LEAST_GAIN = 50.0, 2.0
GAIN_REDUCTION = 0.85
SHORTEST_S = 1e-3  # least remaining delay
SHORTEST_LAG_S = 1e-4  # least lag of a cell file
LONGER_S = 0.005  # overestimate of the delay that the adaptive law is specified for
APPROACH_SHARE = 0.95


@dataclass(frozen=True, slots=True)
class MeasuredCell:
    """Measurements; None when not measured."""

    servo: Servo
    spring: Spring | None
    controller: ContactResponse | None = None


@dataclass(frozen=True, slots=True)
class RatedGain:
    """One gain in one loop, with margins and forecast."""

    gain: float  # m/(N s) or rad/(N m s)
    loop: Loop
    margins: Margins
    forecast: Forecast


@dataclass(frozen=True, slots=True)
class Advice:
    """Recommended and present gains of one loop host."""

    host: Host
    tau_s: float
    force: RatedGain
    torque: RatedGain
    force_now: RatedGain
    torque_now: RatedGain

    @property
    def gains(self) -> Gains:
        """The recommended gains, the same for all axes."""
        return equal_gains(self.force.gain, self.torque.gain)


def advise(
    cell: CellConfig, measured: MeasuredCell, host: Host, *, force_now: float, torque_now: float
) -> Advice:
    """Return the gains for a loop host, by the gain rule, reduced where margins are too small.

    The gains are designed for delays two deviations longer than measured, and for the worst split
    of the measured sum into delay and lag.

    Args:
        cell: The present cell file.
        measured: The measurements.
        host: Loop host: where the regulator runs.
        force_now: Present force gain along the tool's axis [m/(N s)].
        torque_now: Present torque gain across it [rad/(N m s)].
    """
    k, tilt = stiffness_of(cell, measured)
    contact, bandwidth = cell.contact, cell.robot.bandwidth_rad_s
    splits = [_delays(cell, measured, host, lag_s) for lag_s in measured.servo.lags_s]
    force, torque = (
        min(
            (recommended(Loop(stiffness, 0.0, *split, inertia), bandwidth) for split in splits),
            key=lambda loop: loop.gain,
        )
        for stiffness, inertia in ((k, contact.inertia_kg), (tilt, contact.inertia_kg_m2))
    )
    return Advice(
        host=host,
        tau_s=force.tau_s,
        force=rated_gain(force),
        torque=rated_gain(torque),
        force_now=rated_gain(force.with_gain(force_now)),
        torque_now=rated_gain(torque.with_gain(torque_now)),
    )


def refusal_reason(cell: CellConfig, measured: MeasuredCell, advices: list[Advice]) -> str:
    """Return why nothing is recommended; empty when the law covers the measured values."""
    k = cell.contact.stiffness_N_m if measured.spring is None else measured.spring.k_N_m
    found = (range_violation(cell.plant.loop_hz, advice.tau_s, k) for advice in advices)
    return next((text for text in found if text), "")


def remarks(
    cell: CellConfig, measured: MeasuredCell, sections: dict[str, dict[str, float]]
) -> list[str]:
    """Return remarks on the recommended values when the cell uses the adaptive law."""
    if cell.force.law != "adaptive":
        return []
    robot = cell.robot.model_copy(update=sections["robot"])
    texts = [restriction(cell.model_copy(update={"robot": robot}))]
    longer_s = robot.delay_s + robot.lag_s - measured.servo.least_s
    if longer_s > LONGER_S:
        texts.append(
            f"the delay may be overestimated by {1e3 * longer_s:.0f} ms, the adaptive law is "
            f"specified for {1e3 * LONGER_S:g} ms: it settles later, and does not overshoot"
        )
    return [text for text in texts if text]


def _delays(
    cell: CellConfig, measured: MeasuredCell, host: Host, lag_s: float
) -> tuple[float, float, float]:
    """Return dead time, lag and filter time of a loop whose arm has a lag [s]."""
    filter_s = cell.filter.lowpass_s
    if host == "controller" and measured.controller is not None:
        return max(measured.controller.bound_s - lag_s - filter_s, SHORTEST_S), lag_s, filter_s
    others_s = cell.plant.tau_s - cell.robot.delay_s - cell.robot.lag_s - filter_s
    return measured.servo.bound_s - lag_s + others_s, lag_s, filter_s


def stiffness_of(cell: CellConfig, measured: MeasuredCell) -> tuple[float, float]:
    """Return the stiffness and the tilt stiffness to design gains for.

    A softer contact also tilts more easily: the cell file's tilt stiffness is scaled with the
    measured stiffness.
    """
    contact = cell.contact
    if measured.spring is None:
        return contact.stiffness_N_m, contact.tilt_stiffness_Nm_rad
    k = measured.spring.bound_N_m
    return k, contact.tilt_stiffness_Nm_rad * k / contact.stiffness_N_m


def recommended(loop: Loop, bandwidth_rad_s: float) -> Loop:
    """Return the loop with the rule's gain, reduced until the margins are sufficient."""
    loop = loop.with_gain(_rule_gain(loop, bandwidth_rad_s))
    while True:
        found = margins(loop)
        if found.stable and found.phase_deg >= LEAST_PHASE_DEG and found.gain_margin >= LEAST_GAIN:
            return loop
        loop = loop.with_gain(GAIN_REDUCTION * loop.gain)


def rated_gain(loop: Loop) -> RatedGain:
    """Return a loop with its margins and forecast."""
    return RatedGain(loop.gain, loop, margins(loop), forecast(loop))


def cell_file_sections(
    cell: CellConfig, measured: MeasuredCell, advices: list[Advice]
) -> dict[str, dict[str, float]]:
    """Return the cell file sections with the measured values; the gains follow from them.

    One delay serves both loop hosts: that of the slower one. The lag stays the cell file's when it
    is within the measured range.
    """
    fixed_s = cell.plant.tau_s - cell.robot.delay_s - cell.robot.lag_s
    longest_s = max(advice.tau_s for advice in advices)
    lag_s = _rounded_up(max(measured.servo.lag_near_s(cell.robot.lag_s), SHORTEST_LAG_S), 1e-4)
    robot = {"delay_s": _rounded_up(longest_s - fixed_s - lag_s, 1e-3), "lag_s": lag_s}
    if (bandwidth := _bandwidth(cell, advices)) > cell.robot.bandwidth_rad_s:
        robot["bandwidth_rad_s"] = _rounded_up(bandwidth, 0.1)
    found = {"robot": robot}
    if measured.spring is not None:
        k, tilt = (float(f"{value:.3g}") for value in stiffness_of(cell, measured))
        found["contact"] = {"stiffness_N_m": k, "tilt_stiffness_Nm_rad": tilt}
        tau_s = fixed_s + robot["delay_s"] + robot["lag_s"]
        allowed_m_s = cell.force.approach_budget_N / (k * tau_s)
        if cell.force.approach_m_s > allowed_m_s:  # otherwise arming would be refused
            found["force"] = {"approach_m_s": float(f"{APPROACH_SHARE * allowed_m_s:.2g}")}
    return found


def _bandwidth(cell: CellConfig, advices: list[Advice]) -> float:
    """Return the bandwidth [rad/s] whose inertia rule yields the reduced gains."""
    smaller = [
        INERTIA_MARGIN / (rated.loop.inertia * rated.gain)
        for advice in advices
        for rated in (advice.force, advice.torque)
        if rated.gain < 0.99 * _rule_gain(rated.loop, cell.robot.bandwidth_rad_s)
    ]
    return max(smaller, default=0.0)


def _rule_gain(loop: Loop, bandwidth_rad_s: float) -> float:
    """Return the gain of the gain rule, without regard to margins."""
    return rule_gain(
        loop.stiffness, loop.inertia, tau_s=loop.tau_s, bandwidth_rad_s=bandwidth_rad_s
    )


def as_dict(
    cell: CellConfig,
    measured: MeasuredCell,
    advices: list[Advice],
    sections: dict[str, dict[str, float]],
) -> dict[str, Any]:
    """Return the output of `--json`; infinite numbers become null.

    When nothing is recommended, `refusal_reason` has the reason and there are no gains.
    """
    servo, spring, controller = measured.servo, measured.spring, measured.controller
    refusal = refusal_reason(cell, measured, advices)
    return {
        "tau_s": advices[0].tau_s,
        "delay_and_lag_s": servo.sum_s,
        "delay_and_lag_deviation_s": servo.deviation_s,
        "lag_range_s": servo.lags_s,
        "split_is_known": servo.is_split,
        "stiffness_N_m": None if spring is None else spring.k_N_m,
        "stiffness_deviation_N_m": None if spring is None else spring.spread_N_m,
        "controller_tau_s": None if controller is None else controller.tau_s,
        "controller_tau_deviation_s": None if controller is None else controller.deviation_s,
        "refused": refusal or None,
        "remarks": remarks(cell, measured, sections),
        "cell_file": None if refusal else sections,
        "hosts": {advice.host: _host(advice, is_refused=bool(refusal)) for advice in advices},
    }


def _host(advice: Advice, *, is_refused: bool) -> dict[str, Any]:
    now = {
        "tau_s": advice.tau_s,
        "position_now": _plain(advice.force_now),
        "orientation_now": _plain(advice.torque_now),
    }
    if is_refused:
        return now
    return now | {
        "gains": advice.gains.as_dict(),
        "position": _plain(advice.force),
        "orientation": _plain(advice.torque),
    }


def _plain(rated: RatedGain) -> dict[str, Any]:
    numbers = {"gain": rated.gain, **asdict(rated.margins), **asdict(rated.forecast)}
    return {name: None if value == float("inf") else value for name, value in numbers.items()}


def _rounded_up(value: float, step: float) -> float:
    """Return the next multiple of a step, at least zero."""
    return round(max(0, ceil(value / step - 1e-6)) * step, 6)
