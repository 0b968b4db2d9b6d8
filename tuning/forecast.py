"""Forecast of a press and of following a surface, before the arm is armed. Pure.

A model gives each quantity to first order, the map (`force_map.py`) its measured correction and
width. With k the contact stiffness, tau the loop delay, T the loop period, v_a the approach speed,
Ki the integral gain, e the error of the force when the law reacts, and v_n the surface's speed
along its normal:

    settling   plain     t = touch + tau + ln((e - 0.3) / 0.7) / (k Ki)
               adaptive  t = touch + 1.5 tau + T + ln(e) / (k Ki) + half of travel and braking time
    peak       F_set
    following  plain     v_n / Ki + 0.4 N
               adaptive  k v_n tau, at least the noise

Nothing is extrapolated: a job outside of the measured range is refused with what is outside.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import hypot, log, radians, sqrt, tan

from common.config.cell import CellConfig
from control.adaptive import LOOP, slowness, sure_inertia_margin
from control.gain_rule import LOOP_GAIN, tune
from control.measured_range import SAME, range_violation, restriction, softest_N_m
from forcemesh.errors import DataError
from tuning.force_map import Interval, LawMap, force_map

FEED_M_S, SLOPE_DEG = 0.02, 10.0
FOLLOW_NOISE_N, PLAIN_OFFSET_N = 0.3, 0.4
LEAST_LOG, LEAST_RATE_TAUS = 0.05, 0.3
# k tau / (m w_b) below which the adaptive law was seen to ring on moving surfaces.
LEAST_FOLLOWING = 0.8


@dataclass(frozen=True, slots=True)
class ForceJob:
    """A press on a contact, then a feed across a slope of it."""

    setpoint_N: float
    stiffness_N_m: float | None = None  # default: the stiffest of the cell file
    law: str | None = None  # default: that of the cell file
    host: str = "pc"
    mode: str = "position"
    feed_m_s: float = FEED_M_S
    slope_deg: float = SLOPE_DEG


@dataclass(frozen=True, slots=True)
class ForceForecast:
    """Intervals of what a job will show."""

    law: str  # that runs: the plain law where the adaptive one was never measured
    stiffness_N_m: float
    settling_s: Interval  # from the first touch until the force stays within 1 N
    peak_N: Interval  # of the press, on a surface at rest
    follow_error_N: Interval | None  # largest on the slope; None: not covered
    not_followed: str  # why not


def forecast(cell: CellConfig, job: ForceJob) -> ForceForecast:
    """Return the forecast of a job.

    Raises:
        DataError: The map does not cover it; the text names what is outside.
    """
    if text := not_covered(cell, job):
        raise DataError(text)
    law = running_law(cell, job)
    values, law_map = coordinates(cell, job), force_map()[law]
    found = features(law, values)
    intervals = {
        name: law_map.fits[name].interval(model, found)
        for name, model in models(law, values).items()
    }
    not_followed = _not_followed(law, values, law_map)
    return ForceForecast(
        law,
        values["stiffness_N_m"],
        intervals["settling_s"],
        intervals["peak_N"],
        None if not_followed else intervals["follow_error_N"],
        not_followed,
    )


def running_law(cell: CellConfig, job: ForceJob) -> str:
    """Return the law that runs: outside of its range the plain law replaces the adaptive one."""
    law = job.law or cell.force.law
    return "plain" if law == "adaptive" and softest_N_m(cell) is None else law


def coordinates(cell: CellConfig, job: ForceJob) -> dict[str, float]:
    """Return the coordinates of a job in the map, all positive, by name."""
    k = job.stiffness_N_m or cell.contact.stiffness_N_m
    plant, tau_s = cell.plant, cell.plant.tau_s
    normal_m_s = job.feed_m_s * tan(radians(job.slope_deg))
    return {
        "stiffness_N_m": k,
        "stiffest_ratio": plant.stiffness_N_m / k,
        "loop_delay_s": tau_s,
        "period_s": 1.0 / plant.loop_hz,
        "setpoint_N": job.setpoint_N,
        "accel_m_s2": cell.limits.accel_m_s2,
        "speed_max_m_s": min(cell.force.speed_max_m_s, cell.limits.speed_m_s),
        "inertia_kg_s": plant.inertia_kg * plant.bandwidth_rad_s,
        "approach_N": k * plant.probe_m_s * tau_s,
        "surface_N": k * normal_m_s * tau_s,
        "plain_gain": k * tune(cell).force_i_m_per_Ns * tau_s,
    }


def loop_gain(law: str, values: Mapping[str, float]) -> float:
    """Return k Ki tau on an identified contact, to first order."""
    if law == "plain":
        return values["plain_gain"]
    slow, (fast, _) = slowness(values["period_s"]), LOOP
    margin = sure_inertia_margin(slow)
    return min(fast + (LOOP_GAIN - fast) * slow, margin * inertia_share(values))


def inertia_share(values: Mapping[str, float]) -> float:
    """Return k tau / (m w_b): below about one the tool's inertia caps the gain."""
    return values["stiffness_N_m"] * values["loop_delay_s"] / values["inertia_kg_s"]


def models(law: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return the model's value of each quantity, by name."""
    k, tau_s, F = values["stiffness_N_m"], values["loop_delay_s"], values["setpoint_N"]
    contact_N = min(2.0, 0.5 * F)  # from which the law regulates
    touch_s = max(contact_N - 1.0, 0.0) * tau_s / values["approach_N"]
    error_N = max(F - contact_N - values["approach_N"], 0.0)
    time_s = tau_s / loop_gain(law, values)  # 1 / (k Ki)
    travel_s = F / k / values["speed_max_m_s"]
    if law == "plain":
        closing_s = log(max((error_N - 0.3) / 0.7, 1.0 + LEAST_LOG)) * time_s
        settling_s = touch_s + tau_s + max(closing_s, travel_s)
        surface_N = values["surface_N"] / loop_gain(law, values) + PLAIN_OFFSET_N
    else:
        closing_s = log(max(error_N, 1.0 + LEAST_LOG)) * max(time_s, LEAST_RATE_TAUS * tau_s)
        moving_s = 0.5 * (travel_s + sqrt(2.0 * F / k / values["accel_m_s2"]))
        settling_s = touch_s + 1.5 * tau_s + values["period_s"] + closing_s + moving_s
        surface_N = hypot(values["surface_N"], FOLLOW_NOISE_N)
    return {"settling_s": settling_s, "peak_N": F, "follow_error_N": surface_N}


def features(law: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return the features of the fits: logarithms of coordinates, gain, and slowness."""
    found = {name: log(value) for name, value in values.items() if name != "plain_gain"}
    found["surface_share"] = log(values["surface_N"] / values["setpoint_N"])
    found["loop_gain"] = log(loop_gain(law, values))
    found["slowness"] = slowness(values["period_s"])
    return found


def not_covered(cell: CellConfig, job: ForceJob) -> str:
    """Return what of a job is outside of the map, empty when nothing is."""
    law, maps = running_law(cell, job), force_map()
    if law not in maps:
        return f"no forecast for law {law}: the map has {' and '.join(sorted(maps))}"
    return next(_uncovered(cell, job, law), "")


def _uncovered(cell: CellConfig, job: ForceJob, law: str) -> Iterator[str]:
    if job.mode != "position":
        yield f"no forecast for mode {job.mode}: the map was measured with mode position"
    if job.host != "pc":
        yield f"no forecast for host {job.host}: the map was measured with host pc"
    force = cell.force
    for name, is_on in (
        ("force.delay_compensation", force.delay_compensation),
        ("force.surface_tracking", force.surface_tracking),
    ):
        if law == "adaptive" and not is_on:
            yield f"no forecast with {name} off: the map was measured with it"
    values = coordinates(cell, job)
    k, softest = values["stiffness_N_m"], softest_N_m(cell)
    if law == "adaptive" and softest is not None and k < SAME * softest:
        yield f"no forecast at {k:.3g} N/m: {restriction(cell)}"
    if law == "plain" and (text := range_violation(cell.plant.loop_hz, values["loop_delay_s"], k)):
        yield f"no forecast, {text}"
    yield from _out_of_range(values, force_map()[law], RANGED)


# Coordinate: factor to the unit of the text, unit, and what it is.
RANGED: dict[str, tuple[float, str, str]] = {
    "stiffness_N_m": (1.0, "N/m", "contact stiffness"),
    "stiffest_ratio": (1.0, "times", "contact.stiffness_N_m relative to this contact"),
    "loop_delay_s": (1e3, "ms", "delay of the whole loop"),
    "period_s": (1e3, "ms", "loop period (rates.control_hz, rates.robot_hz)"),
    "setpoint_N": (1.0, "N", "set point"),
    "accel_m_s2": (1.0, "m/s2", "limits.accel_m_s2"),
    "speed_max_m_s": (1e3, "mm/s", "force.speed_max_m_s"),
    "inertia_kg_s": (1.0, "kg/s", "contact.inertia_kg times robot.bandwidth_rad_s"),
    "approach_N": (1.0, "N", "stiffness times approach speed times loop delay"),
}
SURFACE = {"surface_N": (1.0, "N", "stiffness times speed of the surface times loop delay")}


def _out_of_range(
    values: Mapping[str, float], law_map: LawMap, named: Mapping[str, tuple[float, str, str]]
) -> Iterator[str]:
    for name, (factor, unit, what) in named.items():
        value, (low, high) = values[name], (law_map.ranges[name].low, law_map.ranges[name].high)
        if not SAME * low <= value * SAME <= high:
            yield (
                f"no forecast: {what} is {factor * value:.3g} {unit}, measured were "
                f"{factor * low:.3g} to {factor * high:.3g} {unit}"
            )


def _not_followed(law: str, values: Mapping[str, float], law_map: LawMap) -> str:
    """Return why following is not forecast, empty when it is."""
    share = inertia_share(values)
    if law == "adaptive" and share < LEAST_FOLLOWING:
        return (
            f"no forecast of following: stiffness times loop delay is {share:.2f} of inertia times "
            f"bandwidth; below {LEAST_FOLLOWING:g} the adaptive law rang on some moving surfaces "
            "by 1 to 6 N: try it at low feed"
        )
    return next(_out_of_range(values, law_map, SURFACE), "")
