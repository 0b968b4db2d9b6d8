"""Presses of a recording, with the forecast of each beside what was measured."""

from pathlib import Path

import numpy as np
import pytest

from cli.report.data import ReportContent, StopEvent
from cli.report.forecasts import PressForce, measured_press, presses_of, rows_of
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.faults import tripped
from forcemesh.requests import (
    ArmRequest,
    Empty,
    ForceStartRequest,
    Reply,
    ServedRequest,
)
from tests.fakes.bench import CELL
from tests.fakes.recorded_cell import Job, recorded
from tests.fakes.verb_calls import run

SETPOINT_N = 15.0
START = '{"mode": "position", "host": "pc", "setpoint_N": 15.0, "law": "plain"}'
PATH = '{"points_m": [[0, 0, 0]], "speed_m_s": 0.03}'
JOB: Job = (
    (topics.TARE, Empty(), 0.2),
    (topics.ARM, ArmRequest(), 0.3),
    (topics.FORCE_START, ForceStartRequest(mode="position", setpoint_N=SETPOINT_N), 2.0),
    (topics.FORCE_STOP, Empty(), 0.1),
)


def served(key: str, payload: str = "{}", *, accepted: bool = True) -> ServedRequest:
    """Return a request with its reply."""
    return ServedRequest(request=key, payload=payload, reply=Reply(accepted=accepted))


def content_of(
    *requests: tuple[float, ServedRequest], stop_s: float | None = None
) -> ReportContent:
    """Return a recording of 20 s with requests and at most one stop."""
    content = ReportContent(0, 20.0, requests=list(requests))
    if stop_s is not None:
        content.stops = [StopEvent(stop_s, "HOLDING", tripped("force", "61 N"))]
    return content


def approach(t_s: Array, final_N: float = SETPOINT_N, tau_s: float = 0.1) -> Array:
    """Return a force that rises from 1 s on, without overshoot."""
    return final_N * (1.0 - np.exp(-np.clip(t_s - 1.0, 0.0, None) / tau_s))


def test_a_report_of_our_own_recording_has_forecast_and_measured(tmp_path: Path) -> None:
    """The whole chain in virtual time: both rows are as forecast."""
    page = tmp_path / "page.html"
    done = run("report", recorded(tmp_path, JOB), "--no-3d", "-o", page)
    settles, peak = (line for line in done.stdout.splitlines() if line.startswith("press at"))
    assert "settles after touch: forecast 0." in settles
    assert settles.endswith("(as forecast)")
    assert peak.endswith("(as forecast)")
    assert "Forecast and measured" in page.read_text(encoding="utf-8")


def test_a_press_ends_with_the_next_request_a_stop_or_the_recording() -> None:
    """Whichever is first; its path begins within it. A refused one is none, nor is one of 0 N."""
    start = served(topics.FORCE_START.key, START)
    (alone,) = presses_of(content_of((1.0, start)))
    assert (alone.at_s, alone.end_s, alone.path_s, alone.feed_m_s) == (1.0, 20.0, None, 0.02)
    (stopped,) = presses_of(content_of((1.0, start), stop_s=4.0))
    assert stopped.end_s == 4.0
    path, end = served(topics.FORCE_PATH.key, PATH), served(topics.FORCE_STOP.key)
    (fed,) = presses_of(content_of((1.0, start), (3.0, path), (6.0, end), (7.0, path)))
    assert (fed.end_s, fed.path_s, fed.feed_m_s) == (6.0, 3.0, 0.03)
    assert fed.request == ForceStartRequest(setpoint_N=15.0, law="plain")
    refused = served(topics.FORCE_START.key, START, accepted=False)
    for request in (refused, *(served(topics.FORCE_START.key, p) for p in ("ff00", "[1]", "{}"))):
        assert list(presses_of(content_of((1.0, request)))) == []


def test_settling_and_peak_are_counted_from_the_first_touch() -> None:
    """First order with 0.1 s: within 1 N of 15 N after 0.1 ln 15, touched at 1 N."""
    t_s = np.arange(0.0, 3.0, 0.002)
    settling_s, peak_N = measured_press(t_s, approach(t_s), SETPOINT_N)
    assert settling_s == pytest.approx(0.1 * np.log(15.0) - 0.1 * np.log(15.0 / 14.0), abs=0.004)
    assert peak_N == pytest.approx(SETPOINT_N, abs=0.01)
    assert measured_press(t_s, approach(t_s, 0.5), SETPOINT_N) == (None, None)


def test_the_error_on_a_path_is_judged_by_the_upper_end() -> None:
    """A flat surface has no error of following."""
    t_s = np.arange(0.0, 6.0, 0.002)
    start, path = served(topics.FORCE_START.key, START), served(topics.FORCE_PATH.key, PATH)
    (press,) = presses_of(content_of((0.0, start), (3.0, path)))
    force_N = approach(t_s) + 0.5 * (t_s > 3.5)
    settles, peak, fed = rows_of(CELL, press, PressForce(list(t_s), list(force_N)))
    assert fed.quantity == "error at 30 mm/s (slope up to 10 degrees)"
    assert fed.measured == pytest.approx(0.5, abs=0.01)
    assert fed.texts[-1] == "as forecast"
    assert peak.measured == pytest.approx(SETPOINT_N, abs=0.01)
    assert settles.texts[-1] == "above the forecast"
