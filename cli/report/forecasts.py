"""Presses of a recording: the forecast of each beside what was measured.

A press is a request to start force feedback with a mode of the specification and a set point. Its
force is that along the tool's axis, from the request until the next request to the regulator, a
stop of the arm, or the end. Settling and peak are of the time before a path begins; the error while
a tool is fed is of the path, relative to the set point.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from cli.pages import table
from cli.report.data import ReportContent, sampled_snapshots
from common.config.cell import CellConfig
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.errors import DataError
from forcemesh.requests import ForceStartRequest
from services.panel.markup import Html, html
from services.panel.readout import Readout
from tuning.force_map import Interval
from tuning.forecast import FEED_M_S, SLOPE_DEG, ForceForecast, ForceJob, forecast

if TYPE_CHECKING:
    from services.recorder.reading import RecordedFile

TOUCH_N = SETTLED_N = 1.0
MEAN_S, KEPT_S = 0.008, 0.5  # of a settled force: within the band for so long
SAMPLED_HZ = 1000.0
ENDS = (topics.FORCE_START.key, topics.FORCE_STOP.key, topics.HOLD.key)
HEAD = ("press at [s]", "quantity", "forecast", "measured", "")


@dataclass(frozen=True, slots=True)
class Press:
    """One press of a recording: request, its time [s], and the time of its path, if it has one."""

    at_s: float
    end_s: float
    request: ForceStartRequest
    path_s: float | None
    feed_m_s: float


@dataclass(slots=True)
class PressForce:
    """Force along the tool's axis during a press."""

    t_s: list[float] = field(default_factory=list)
    push_N: list[float] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class PressRow:
    """One quantity of a press: what was forecast, and what was measured. None: unknown."""

    at_s: float
    quantity: str
    unit: str
    forecast: Interval | None
    measured: float | None
    remark: str = ""

    @property
    def texts(self) -> tuple[str, str, str, str, str]:
        """Cells of the table."""
        interval, value = self.forecast, self.measured
        verdict = self.remark
        if interval is not None and value is not None:
            verdict = "as forecast"
            if not interval.contains(value):
                verdict = "below the forecast" if value < interval.low else "above the forecast"
        return (
            f"{self.at_s:.2f}",
            self.quantity,
            "-" if interval is None else f"{interval.low:.3g} to {interval.high:.3g} {self.unit}",
            "-" if value is None else f"{value:.3g} {self.unit}",
            verdict,
        )


def forecast_rows(read: "RecordedFile", cell: CellConfig, content: ReportContent) -> list[PressRow]:
    """Return the rows of every press of a recording, in its order."""
    presses = list(presses_of(content))
    if not presses:
        return []
    forces, readout = [PressForce() for _ in presses], Readout(cell)
    for at_s, snapshot in sampled_snapshots(read, content.begin_ns, SAMPLED_HZ):
        push_N = readout.numbers(snapshot).get("press")
        for press, force in zip(presses, forces, strict=True):
            if push_N is not None and press.at_s <= at_s <= press.end_s:
                force.t_s.append(at_s)
                force.push_N.append(push_N)
    pairs = zip(presses, forces, strict=True)
    return [row for press, force in pairs for row in rows_of(cell, press, force)]


def presses_of(content: ReportContent) -> Iterator[Press]:
    """Yield the presses: accepted starts with a set point, without tasks and hand guiding."""
    stops_s = [stop.at_s for stop in content.stops]
    asked = [
        (at_s, served.request, _fields(served.payload))
        for at_s, served in content.requests
        if served.reply is not None and served.reply.accepted
    ]
    closed = [*asked, (content.duration_s, topics.FORCE_STOP.key, {})]
    for number, (at_s, key, fields) in enumerate(asked):
        if key != topics.FORCE_START.key or fields.get("task") or not fields.get("setpoint_N"):
            continue
        later = closed[number + 1 :]
        end_s = next(t for t, name, _ in later if name in ENDS)
        end_s = min([end_s, *(t for t in stops_s if t >= at_s)])
        paths = [
            (t, float(f.get("speed_m_s", FEED_M_S)))
            for t, name, f in later
            if name == topics.FORCE_PATH.key and t < end_s and (f.get("points_m") or f.get("poses"))
        ]
        path_s, feed_m_s = paths[0] if paths else (None, FEED_M_S)
        yield Press(at_s, end_s, _request(fields), path_s, feed_m_s)


def _fields(payload: str) -> dict[str, Any]:
    """Return the fields of a served request; none of one that was too long or not decoded."""
    try:
        fields = json.loads(payload)
    except ValueError:
        return {}
    return fields if isinstance(fields, dict) else {}


def _request(fields: dict[str, Any]) -> ForceStartRequest:
    return ForceStartRequest(
        mode=fields.get("mode", "position"),
        host=fields.get("host", "pc"),
        law=fields.get("law"),
        setpoint_N=float(fields["setpoint_N"]),
    )


def rows_of(cell: CellConfig, press: Press, force: PressForce) -> Iterator[PressRow]:
    """Yield the rows of one press."""
    found, remark = _forecast(cell, press)
    setpoint_N = press.request.setpoint_N
    t, push = np.array(force.t_s), np.array(force.push_N)
    smooth = moving_mean(t, push)
    starts_free = len(t) > 0 and smooth[0] <= TOUCH_N
    quiet = t < (press.end_s if press.path_s is None else press.path_s)
    settling_s, peak_N = measured_press(t[quiet], smooth[quiet], setpoint_N)
    if not starts_free:
        settling_s, remark = None, remark or "started in contact"
    interval = found.settling_s if found and starts_free else None
    yield PressRow(press.at_s, "settles after touch", "s", interval, settling_s, remark)
    interval = found.peak_N if found and starts_free else None
    yield PressRow(press.at_s, "peak", "N", interval, peak_N, remark)
    if press.path_s is not None and (~quiet).any():
        error_N = float(np.abs(smooth[~quiet] - setpoint_N).max())
        label = f"error at {1e3 * press.feed_m_s:.3g} mm/s (slope up to {SLOPE_DEG:g} degrees)"
        slope_N = found.follow_error_N if found else None
        slope_N = None if slope_N is None else Interval(0.0, slope_N.high)  # flat or steep
        on_path = remark or (found.not_followed if found else "")
        yield PressRow(press.at_s, label, "N", slope_N, error_N, on_path)


def _forecast(cell: CellConfig, press: Press) -> tuple[ForceForecast | None, str]:
    request = press.request
    job = ForceJob(
        request.setpoint_N,
        law=request.law,
        host=request.host,
        mode=request.mode,
        feed_m_s=press.feed_m_s,
    )
    try:
        return forecast(cell, job), ""
    except DataError as error:
        return None, str(error)


def measured_press(
    t_s: Array, smooth_N: Array, setpoint_N: float
) -> tuple[float | None, float | None]:
    """Return settling after the first touch [s] and peak [N]; None: no touch, or not settled."""
    touched = np.flatnonzero(smooth_N > TOUCH_N)
    if len(touched) == 0:
        return None, None
    first_s, peak_N = float(t_s[touched[0]]), float(smooth_N[touched[0] :].max())
    outside_s = [*t_s[np.abs(smooth_N - setpoint_N) > SETTLED_N], t_s[-1]]
    for out_s, next_s in pairwise(outside_s):
        if out_s >= first_s and next_s - out_s > KEPT_S:
            return float(t_s[np.searchsorted(t_s, out_s, side="right")] - first_s), peak_N
    return None, peak_N


def moving_mean(t_s: Array, values: Array) -> Array:
    """Return each value averaged over the last few milliseconds. Shape (n,)."""
    first = np.searchsorted(t_s, t_s - MEAN_S)
    total = np.concatenate([[0.0], np.cumsum(values)])
    last = np.arange(1, len(t_s) + 1)
    return np.asarray((total[last] - total[first]) / (last - first))


def section_of(rows: Sequence[PressRow]) -> Html:
    """Return the section of the page; empty without a press."""
    if not rows:
        return html("")
    body = table(HEAD, [row.texts for row in rows])
    return html('<h2>Forecast and measured</h2><div class="scroll">{}</div>', body)


def lines_of(rows: Sequence[PressRow]) -> list[str]:
    """Return the same as lines for the terminal."""
    return [
        f"press at {at_s} s, {quantity}: forecast {forecast_text}, measured {measured}"
        + (f" ({remark})" if remark else "")
        for at_s, quantity, forecast_text, measured, remark in (row.texts for row in rows)
    ]
