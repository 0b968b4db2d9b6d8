"""What was measured, turned into gains, margins and the lines of a cell file. Pure."""

from dataclasses import asdict, dataclass
from math import ceil
from typing import Any

from cli.tuning.identify import Servo, Spring
from cli.tuning.margins import Forecast, Loop, Margins, forecast, margins
from common.cell import Cell
from common.messages import Gains, Host
from services.regulator.tuning import INERTIA_MARGIN, LOOP_GAIN

LEAST_PHASE_DEG, LEAST_GAIN = 50.0, 2.0
SMALLER = 0.85
MORE_DELAY_S = 0.001  # the delay is rather said too long than too short
APPROACH_SHARE = 0.95


@dataclass(frozen=True, slots=True)
class Measured:
    """What was measured; None is what was not."""

    servo: Servo
    spring: Spring | None
    controller_tau_s: float | None = None


@dataclass(frozen=True, slots=True)
class Judged:
    """One gain in one loop."""

    gain: float  # m/(N s) or rad/(N m s)
    loop: Loop
    margins: Margins
    forecast: Forecast


@dataclass(frozen=True, slots=True)
class Advice:
    """What is recommended for one host, beside what is set now."""

    host: Host
    tau_s: float
    force: Judged
    torque: Judged
    force_now: Judged
    torque_now: Judged

    @property
    def gains(self) -> Gains:
        """The recommended gains, the same for all axes."""
        force, torque = self.force.gain, self.torque.gain
        return Gains(
            force_i_m_per_Ns=(force, force, force), torque_i_rad_per_Nms=(torque, torque, torque)
        )


def advise(
    cell: Cell, measured: Measured, host: Host, *, force_now: float, torque_now: float
) -> Advice:
    """Return the gains for a host, by the gain rule, and less where their margins are too small.

    Args:
        cell: The cell as it is set up now.
        measured: What was measured.
        host: Where the regulator runs.
        force_now: Gain of force along the tool's axis that is set now [m/(N s)].
        torque_now: Gain of torque across it [rad/(N m s)].
    """
    lag_s, filter_s = measured.servo.lag_s, cell.filter.lowpass_s
    if host == "controller" and measured.controller_tau_s is not None:
        delay_s = max(measured.controller_tau_s - lag_s - filter_s, 1e-3)
    else:
        others_s = cell.loop_delay_s - cell.robot.delay_s - cell.robot.lag_s - filter_s
        delay_s = measured.servo.delay_s + others_s
    k, tilt = stiffness_of(cell, measured)
    contact = cell.contact
    force = Loop(k, 0.0, delay_s, lag_s, filter_s, contact.inertia_kg)
    torque = Loop(tilt, 0.0, delay_s, lag_s, filter_s, contact.inertia_kg_m2)
    bandwidth = cell.robot.bandwidth_rad_s
    return Advice(
        host=host,
        tau_s=force.tau_s,
        force=judged(recommended(force, bandwidth)),
        torque=judged(recommended(torque, bandwidth)),
        force_now=judged(force.with_gain(force_now)),
        torque_now=judged(torque.with_gain(torque_now)),
    )


def stiffness_of(cell: Cell, measured: Measured) -> tuple[float, float]:
    """Return the stiffness and the tilt stiffness that gains are to be safe for.

    A face that rests on something softer tilts the more easily: the cell file's tilt stiffness
    goes down with what was measured, and up.
    """
    contact = cell.contact
    if measured.spring is None:
        return contact.stiffness_N_m, contact.tilt_stiffness_Nm_rad
    k = measured.spring.bound_N_m
    return k, contact.tilt_stiffness_Nm_rad * k / contact.stiffness_N_m


def recommended(loop: Loop, bandwidth_rad_s: float) -> Loop:
    """Return the loop with the rule's gain, or with less where that leaves too little margin."""
    gain = _ruled(loop, bandwidth_rad_s)
    while not _is_safe(margins(loop.with_gain(gain))):
        gain *= SMALLER
    return loop.with_gain(gain)


def judged(loop: Loop) -> Judged:
    """Return a loop with its margins and what it will do."""
    return Judged(loop.gain, loop, margins(loop), forecast(loop))


def lines(cell: Cell, measured: Measured, advices: list[Advice]) -> dict[str, dict[str, float]]:
    """Return the sections of the cell file that say what was measured; the gains follow from them.

    One delay must serve both hosts: it is that of the slower one.
    """
    fixed_s = cell.loop_delay_s - cell.robot.delay_s - cell.robot.lag_s
    longest_s = max(advice.tau_s for advice in advices)
    delay_s = longest_s - fixed_s - measured.servo.lag_s + MORE_DELAY_S
    robot = {"delay_s": _up(delay_s, 1e-3), "lag_s": _up(measured.servo.lag_s, 1e-4)}
    if (bandwidth := _bandwidth(cell, advices)) > cell.robot.bandwidth_rad_s:
        robot["bandwidth_rad_s"] = _up(bandwidth, 0.1)
    found = {"robot": robot}
    if measured.spring is not None:
        k, tilt = (float(f"{value:.3g}") for value in stiffness_of(cell, measured))
        found["contact"] = {"stiffness_N_m": k, "tilt_stiffness_Nm_rad": tilt}
        tau_s = fixed_s + robot["delay_s"] + robot["lag_s"]
        allowed_m_s = cell.force.approach_budget_N / (k * tau_s)
        if cell.force.approach_m_s > allowed_m_s:  # else it could not be armed any more
            found["force"] = {"approach_m_s": float(f"{APPROACH_SHARE * allowed_m_s:.2g}")}
    return found


def _bandwidth(cell: Cell, advices: list[Advice]) -> float:
    """Return the bandwidth [rad/s] whose inertia rule gives the gains that margins made smaller."""
    smaller = [
        INERTIA_MARGIN / (one.loop.inertia * one.gain)
        for advice in advices
        for one in (advice.force, advice.torque)
        if one.gain < 0.99 * _ruled(one.loop, cell.robot.bandwidth_rad_s)
    ]
    return max(smaller, default=0.0)


def _ruled(loop: Loop, bandwidth_rad_s: float) -> float:
    """Return what the gain rule says, whatever its margins are."""
    return min(
        LOOP_GAIN / (loop.stiffness * loop.tau_s),
        INERTIA_MARGIN / (loop.inertia * bandwidth_rad_s),
    )


def as_dict(
    measured: Measured, advices: list[Advice], sections: dict[str, dict[str, float]]
) -> dict[str, Any]:
    """Return what `--json` prints; numbers that are infinite become null."""
    spring = measured.spring
    return {
        "tau_s": advices[0].tau_s,
        "delay_s": measured.servo.delay_s,
        "lag_s": measured.servo.lag_s,
        "stiffness_N_m": None if spring is None else spring.k_N_m,
        "stiffness_spread_N_m": None if spring is None else spring.spread_N_m,
        "cell_file": sections,
        "hosts": {
            advice.host: {
                "tau_s": advice.tau_s,
                "gains": advice.gains.model_dump(),
                "position": _plain(advice.force),
                "position_now": _plain(advice.force_now),
                "orientation": _plain(advice.torque),
                "orientation_now": _plain(advice.torque_now),
            }
            for advice in advices
        },
    }


def _plain(one: Judged) -> dict[str, Any]:
    numbers = {"gain": one.gain, **asdict(one.margins), **asdict(one.forecast)}
    return {name: None if value == float("inf") else value for name, value in numbers.items()}


def _is_safe(found: Margins) -> bool:
    return found.stable and found.phase_deg >= LEAST_PHASE_DEG and found.gain >= LEAST_GAIN


def _up(value: float, step: float) -> float:
    """Return the next multiple of a step, at least zero."""
    return round(max(0, ceil(value / step - 1e-6)) * step, 6)
