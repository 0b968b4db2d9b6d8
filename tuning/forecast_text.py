"""Forecasts as texts: limits that they break, one line for a form, rows of a table. Pure."""

from collections.abc import Iterator
from dataclasses import replace
from math import floor, radians, tan
from typing import NamedTuple

from common.config.cell import CellConfig
from forcemesh.errors import DataError
from tuning.force_map import Interval, force_map
from tuning.forecast import ForceForecast, ForceJob, forecast, not_covered, running_law

BISECTIONS = 20
SLOWEST_FEED_M_S = 0.001  # below it a slower feed is no remedy


class ForecastRow(NamedTuple):
    """One quantity of a forecast, for a table."""

    quantity: str
    unit: str
    interval: Interval | None
    limit: float | None
    verdict: str


def warnings(cell: CellConfig, job: ForceJob, found: ForceForecast) -> Iterator[str]:
    """Yield every limit that a forecast breaks, with its number and the remedy."""
    ceiling_N, most_m_s = cell.limits.force_N, cell.force.speed_max_m_s
    if found.peak_N.high > ceiling_N:
        yield (
            f"the press may peak at {found.peak_N.high:.0f} N, limits.force_N is {ceiling_N:g} N, "
            "where the arm holds: lower the set point"
        )
    normal_m_s = job.feed_m_s * tan(radians(job.slope_deg))
    if normal_m_s > most_m_s:
        yield (
            f"a slope of {job.slope_deg:g} degrees at {1e3 * job.feed_m_s:.3g} mm/s moves at "
            f"{1e3 * normal_m_s:.3g} mm/s along the tool, force.speed_max_m_s is "
            f"{1e3 * most_m_s:.3g} mm/s: feed at most "
            f"{1e3 * most_m_s / tan(radians(job.slope_deg)):.3g} mm/s"
        )
    error_N = found.follow_error_N
    if error_N is not None and (most_N := job.setpoint_N + error_N.high) > ceiling_N:
        yield (
            f"at {1e3 * job.feed_m_s:.3g} mm/s across a slope of {job.slope_deg:g} degrees the "
            f"force may rise from {job.setpoint_N:.3g} N to {most_N:.0f} N, limits.force_N is "
            f"{ceiling_N:g} N, where the arm holds: {_slower(cell, job)}"
        )


def _slower(cell: CellConfig, job: ForceJob) -> str:
    """Return the remedy: the fastest feed with which the force stays below its ceiling."""
    room_N = cell.limits.force_N - job.setpoint_N
    low_m_s, high_m_s = SLOWEST_FEED_M_S, job.feed_m_s
    for _ in range(BISECTIONS):
        middle_m_s = 0.5 * (low_m_s + high_m_s)
        is_within = _error_N(cell, replace(job, feed_m_s=middle_m_s)) < room_N
        low_m_s, high_m_s = (middle_m_s, high_m_s) if is_within else (low_m_s, middle_m_s)
    if low_m_s <= SLOWEST_FEED_M_S:
        return "lower the set point"
    return f"feed at most {floor(1e4 * low_m_s) / 10:g} mm/s, or lower the set point"


def _error_N(cell: CellConfig, job: ForceJob) -> float:
    """Return the largest error on a slope; the noise at a feed slower than the map has."""
    error_N = forecast(cell, job).follow_error_N
    return 0.0 if error_N is None else error_N.high


def arming_text(cell: CellConfig) -> str:
    """Return a note for the reply to `arm`: the limit that the cell's own press would break.

    The press has the cell's stiffest contact, its law and its largest set point, as far as the map
    has it. Empty: no limit is broken, or the map does not cover the cell.
    """
    law = running_law(cell, ForceJob(cell.force.setpoint_max_N))
    try:
        maps = force_map()
    except DataError as error:
        return f"; no forecast: {error}"  # a damaged map is no reason to stop the arbiter
    if "pc" not in cell.robot.hosts or law not in maps:
        return ""
    job = ForceJob(min(cell.force.setpoint_max_N, maps[law].ranges["setpoint_N"].high))
    if not_covered(cell, job):
        return ""
    found = next(warnings(cell, job, forecast(cell, job)), "")
    return f"; forecast: {found}" if found else ""


def one_line(cell: CellConfig, job: ForceJob) -> str:
    """Return the forecast of a job in one line, or why there is none."""
    try:
        found = forecast(cell, job)
    except DataError as error:
        return str(error)
    settling, peak, error_N = found.settling_s, found.peak_N, found.follow_error_N
    parts = [
        f"forecast: settles {settling.low:.2g} to {settling.high:.2g} s after touch",
        f"peak {peak.low:.1f} to {peak.high:.1f} N",
    ]
    if error_N is not None:
        parts.append(
            f"follows {1e3 * job.feed_m_s:.3g} mm/s across {job.slope_deg:g} degrees within "
            f"{error_N.high:.2g} N"
        )
    broken = "".join(f" ⚠ {text}" for text in warnings(cell, job, found))
    return ", ".join(parts) + broken


def rows(cell: CellConfig, job: ForceJob, found: ForceForecast) -> list[ForecastRow]:
    """Return the quantities of a forecast with their limits and verdicts."""
    ceiling_N, error_N = cell.limits.force_N, found.follow_error_N
    made = [
        ForecastRow("settles after touch, within 1 N", "s", found.settling_s, None, ""),
        ForecastRow(
            "peak of the press", "N", found.peak_N, ceiling_N, _verdict(found.peak_N, ceiling_N)
        ),
    ]
    label = f"error at {1e3 * job.feed_m_s:.3g} mm/s, slope of {job.slope_deg:g} degrees"
    if error_N is None:
        return [*made, ForecastRow(label, "N", None, None, "not covered")]
    room_N = ceiling_N - job.setpoint_N
    verdict = _verdict(error_N, room_N)
    if verdict == "within" and error_N.high > job.setpoint_N:
        verdict = "contact may be lost downhill"
    return [*made, ForecastRow(label, "N", error_N, room_N, verdict)]


def _verdict(interval: Interval, limit: float) -> str:
    if interval.high <= limit:
        return "within"
    return "above" if interval.low > limit else "may be above"
