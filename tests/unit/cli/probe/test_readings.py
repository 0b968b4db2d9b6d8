"""Replies of the probe program as values, what a trace shows, and the fingerprint: never a guess.

Order, search and permission: tests/unit/controller/test_fmprobe_as.py, on the emulated controller.
"""

from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.probe.fingerprint import fingerprint
from cli.probe.readings import ProbeReadings, trace_of
from cli.probe.stages import Found
from common.config.probe import ProbeFile

TRAVEL_MM, SPEED_MM_S = 5.0, 10.0


def trapezoid_mm(t: np.ndarray, ramp: float) -> np.ndarray:
    """Return the travel of a motion with a ramp to its speed and one to its stop."""
    rate = np.clip(np.minimum(t, TRAVEL_MM / SPEED_MM_S + ramp - t) / ramp, 0.0, 1.0)
    return np.cumsum(rate * SPEED_MM_S * np.gradient(t))


def samples(delay_s: float, lag_s: float, ramp: float) -> list[tuple[float, float]]:
    """Return the samples of an arm with a dead time and a lag of first order."""
    dt = 1e-4
    t = np.arange(0.0, 1.0, dt)
    command = trapezoid_mm(t, ramp)
    arm, travel = np.empty_like(t), 0.0
    for k, target in enumerate(command):
        travel += (target - travel) * dt / lag_s
        arm[k] = travel
    arm = np.interp(t - delay_s, t, arm, left=0.0)
    return list(zip(t[::41].tolist(), arm[::41].tolist(), strict=True))


def test_a_line_of_each_kind_is_read() -> None:
    """Values, refused steps, lines with their expected values, samples."""
    found = ProbeReadings.of([
        "a 1", "a 2", "b ? -10116", "line.round -6  -6", "line.sum 3  4", "line.call 5 ? -30102",
        "text.mid /cd/ /cd/", "text.none // /x/", "s 0.1 2.5",
    ])  # fmt: skip
    assert found.numbers == {"a": [1.0, 2.0]}
    assert found.get("a") == 2.0
    assert found.get("b") is None
    assert found.failed == {"b": -10116}
    assert found.samples == [(0.1, 2.5)]
    assert {name: (line.found, line.same) for name, line in found.checks.items()} == {
        "line.round": ("-6", True), "line.sum": ("4", False),
        "line.call": ("error -30102", False), "text.mid": ("cd", True), "text.none": ("x", False),
    }  # fmt: skip


# --- traces ---------------------------------------------------------------------------------------


@given(st.floats(0.0, 0.05), st.floats(0.004, 0.04), st.floats(0.002, 0.03))
def test_delay_and_lag_come_back_from_a_trace(delay_s: float, lag: float, ramp: float) -> None:
    """Their sum within 2 ms, the lag within 6 % or 1 ms."""
    trace = trace_of(samples(delay_s, lag, ramp), TRAVEL_MM)
    assert trace is not None
    assert trace.speed_mm_s == pytest.approx(SPEED_MM_S, rel=0.02)
    mean_s = trace.half_s - 0.5 * (TRAVEL_MM / SPEED_MM_S + ramp)
    assert mean_s == pytest.approx(delay_s + lag, abs=2e-3)
    found_s = max(0.0, trace.spread_s2 - ramp * ramp / 12.0) ** 0.5
    assert found_s == pytest.approx(lag, rel=0.06, abs=1e-3)


NOW = datetime(2026, 1, 1, tzinfo=UTC)


def readings(**values: float) -> ProbeReadings:
    """Return a reply; a double underscore stands for a dot."""
    return ProbeReadings(
        numbers={name.replace("__", "."): [value] for name, value in values.items()}
    )


def file_of(found: Found) -> ProbeFile:
    """Return the fingerprint."""
    return fingerprint(found, now=NOW, controller="F60", address="h:1")


@pytest.mark.parametrize("stages", [[], ["a"], ["a", "b"], ["a", "b", "c"]])
def test_what_was_not_measured_is_null_with_a_reason(stages: list[str]) -> None:
    """And in neither section that others read."""
    file = file_of(Found(stages))
    assert file.behaviour == {}
    assert not file.robot.model_dump(exclude_none=True)
    assert not file.gateway.model_dump(exclude_none=True)
    assert all(result.value is None and result.why for result in file.results.values())
    assert (file.measured_at, file.controller, file.address) == (NOW, "F60", "h:1")
    reasons = {result.why for result in file.results.values()}
    assert ("stage c was not run to its end" in reasons) is ("c" not in stages)


SAME_TURNS = {
    f"joint {unit} {number}": readings(joint__took_s=0.4)
    for unit in ("%", "mm/s") for number in (1, 2)
}  # fmt: skip
LATER = {"gap__moved": 1.0, "gap__idle_s": 0.02, "gap__first_s": 0.52}


@pytest.mark.parametrize(
    ("found", "name", "why"),
    [
        (Found(segments=[(0.04, 0, 0.04), (0.03, 0, 0.03)]), "least_segment_s",
         "no E1117 down to 0.0300 s"),
        (Found(segments=[(0.1, -31117, 0.1)]), "least_segment_s", "already at 0.1 s"),
        (Found(segments=[(0.08, -36007, 0.08)]), "least_segment_s", "the error -36007"),
        (Found(), "least_segment_s", "no series"),
        (Found(motion={"ahead": readings(ahead=0.0)}), "motions_ahead", ""),
        (Found(motion={"first": readings(**LATER)}), "planning_stall_s", "EXECUTE fp.main again"),
        (Found(motion={"brake": readings(brake__done=1.0, brake__mm=5.0)}),
         "brake_keeps_prefetched", ""),  # it came to the end without it
        (Found(motion=SAME_TURNS), "joint6_full_deg_s", "the durations of the turns do not differ"),
        (Found(wire=readings(stopped=-30999.0)), "pc_error_stops_robot", ""),
        (Found(wire=readings(flood__longest_s=0.2)), "send_ignores_timeout", ""),
        (Found(still=readings(timer__least_s=0.004, timer__reads=1000.0, timer__equal=10.0)),
         "timer_grain_s", "finer than one step"),
    ],
)  # fmt: skip
def test_a_reading_that_shows_no_value_is_null_with_its_reason(
    found: Found, name: str, why: str
) -> None:
    """And in no section that others read."""
    found.stages = ["a", "b", "c"]
    file = file_of(found)
    results = file.results
    result = results.get(f"behaviour.{name}") or results[f"motion.{name}"]
    assert result.value is None
    assert why in result.why
    assert name not in file.behaviour


def test_a_line_that_is_no_result_is_kept_as_malformed() -> None:
    """It gives no value and no error."""
    lines = ["a", "a b", "", "s 1", "line.x", "line.x 1 y", "b ? x", "a 1 2", "b ?", "line.x 1 ?",
             "b ? inf", "a nan", "a inf", "s 1 nan", "line.x 1 inf"]  # fmt: skip
    found = ProbeReadings.of([*lines, "a 1"])
    assert found == ProbeReadings(numbers={"a": [1.0]}, malformed=lines)
