"""Replies of the probe program as values, and what a trace shows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.probe.readings import ProbeReadings, duration_s, ramp_s, trace_of

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


# --- replies --------------------------------------------------------------------------------------


@given(st.floats(-1e6, 1e6, allow_nan=False), st.sampled_from(["mspeed", "switch.cp", "a.b_s"]))
def test_a_value_survives_the_line(value: float, name: str) -> None:
    """As AS prints a number: eight digits."""
    found = ProbeReadings.of([f"{name}  {value:.8g}"])
    assert found.get(name) == pytest.approx(value, rel=1e-7, abs=1e-9)
    assert not found.malformed


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


@pytest.mark.parametrize(
    "line",
    ["a", "a b", "", "s 1", "line.x", "line.x 1 y", "b ? x", "a 1 2", "b ?", "line.x 1 ?",
     "b ? inf", "a nan", "a inf", "s 1 nan", "line.x 1 inf"],
)  # fmt: skip
def test_a_line_that_is_no_result_is_kept_as_malformed(line: str) -> None:
    """It gives no value and no error."""
    found = ProbeReadings.of([line, "a 1"])
    assert found.malformed == [line]
    assert found.numbers == {"a": [1.0]}


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


@given(st.floats(0.001, 0.5), st.floats(2.0, 20.0))
def test_the_ramp_comes_back_from_two_motions(ramp: float, slower: float) -> None:
    """Also where the speed is not reached."""
    longer_s = duration_s(TRAVEL_MM, SPEED_MM_S, slower * ramp) - duration_s(
        TRAVEL_MM, SPEED_MM_S, ramp
    )
    found = ramp_s(TRAVEL_MM, SPEED_MM_S, slower=slower, later_s=0.5 * longer_s)
    assert found == pytest.approx(ramp, rel=1e-6)
