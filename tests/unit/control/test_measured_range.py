"""Measured range: outside that of the adaptive law the plain law runs, with a message."""

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell import CellConfig
from common.config.load import load_cell
from control import measured_range
from control.adaptive import AdaptiveSettings, gain_for
from control.measured_range import (
    range_violation,
    restriction,
    segment_approach_m_s,
    segment_range,
    softest_N_m,
)
from forcemesh.requests import ForceStartRequest
from tests.fakes.bench import CELL, DEMO
from tests.fakes.regulator_bench import RegulatorBench

ADAPTIVE = ForceStartRequest(mode="position", law="adaptive")


def cell_at(loop_hz: float, delay_s: float) -> CellConfig:
    """Return the demo's cell with another loop rate and delay of its arm."""
    rates = CELL.rates.model_copy(update={"control_hz": loop_hz, "robot_hz": loop_hz})
    robot = CELL.robot.model_copy(update={"delay_s": delay_s})
    return CELL.model_copy(update={"rates": rates, "robot": robot})


@pytest.mark.parametrize(
    ("loop_hz", "delay_ms", "softest"),
    [(250, 10, 1e3), (250, 60, 1e3), (60, 60, 1e3), (40, 45, 5e3), (15, 60, 5e3), (15, 30, 2e3),
     (40, 66, 5e3), (60, 61, 5e3), (250, 71, 5e3), (14, 30, None), (60, 121, None)],
)  # fmt: skip
def test_the_map_gives_the_softest_contact_of_the_law(loop_hz, delay_ms, softest) -> None:
    """A slow loop with a long delay excludes soft contacts; beyond all rows no contact is valid."""
    cell = cell_at(loop_hz, delay_ms / 1e3)
    assert softest_N_m(cell) == softest
    assert bool(restriction(cell)) == (softest != 1e3)


@given(st.floats(15.0, 60.0), st.floats(0.031, 0.06), st.floats(200.0, 2e5))
def test_below_its_softest_contact_the_gain_is_the_plain_laws(loop_hz, delay_s, k_N_m) -> None:
    """Below it the law predicts nothing; above it the gain is the adaptive one."""
    settings = AdaptiveSettings.of(cell_at(loop_hz, delay_s))
    Ki, w = gain_for([k_N_m] * 3, [inf] * 3, settings, 1.0 / loop_hz)
    if k_N_m < settings.softest_N_m:
        assert max(Ki) <= settings.plain_gain_m_per_Ns * (1.0 + 1e-12)
        assert not any(w)
    assert settings.softest_N_m in {row.softest_N_m for row in measured_range.ADAPTIVE}


def test_a_start_outside_the_map_runs_the_plain_law_and_reports_it() -> None:
    """The answer and the target name the law that runs."""
    bench = RegulatorBench(cell_at(60.0, 0.15))
    bench.pass_s(0.3)
    reply = bench.start(ADAPTIVE)
    assert reply.accepted
    assert "law plain" in reply.text
    assert "never measured at 60 Hz and 150 ms" in reply.text
    bench.step()
    assert bench.published().law == "plain"


@pytest.mark.parametrize(
    ("loop_hz", "tau_s", "k_N_m", "reason"),
    [
        (250.0, 0.17, 1e3, ""),
        (15.0, 0.17, 2e5, ""),
        (14.9, 0.05, 1e4, "too slow: the loop runs at 14.9 Hz, the law was measured down to 15 Hz"),
        (250.0, 0.171, 1e4, "too slow: the loop delay is 171 ms"),
        (250.0, 0.05, 2.01e5, "too stiff: 2.01e+05 N/m"),
        (124.0, 0.05, 4.9e3, "too soft: 4.9e+03 N/m, at 124 Hz the law was measured from 5000 N/m"),
    ],
)
def test_the_plain_law_names_what_is_outside_its_range(loop_hz, tau_s, k_N_m, reason) -> None:
    """Every limit itself is inside."""
    found = range_violation(loop_hz, tau_s, k_N_m)
    assert found.startswith(reason)
    assert bool(found) == bool(reason)


def test_the_approach_that_segments_bear_is_unlimited_without_them() -> None:
    """No gateway, a packet of the specification, or segments longer than all that were measured."""
    over_tcp = load_cell(DEMO.with_name("demo-tcp.yaml"))
    assert over_tcp.gateway is not None
    row = segment_range(over_tcp.gateway.least_segment_s)
    assert row is not None
    rate_N_s = segment_approach_m_s(over_tcp) * over_tcp.contact.stiffness_N_m
    assert rate_N_s == pytest.approx(row.force_rate_N_s, rel=1e-5)
    assert rate_N_s < row.force_rate_N_s
    for changes in ({"protocol": "plain"}, {"least_segment_s": 0.5}):
        gateway = over_tcp.gateway.model_copy(update=changes)
        assert segment_approach_m_s(over_tcp.model_copy(update={"gateway": gateway})) == inf
    assert segment_approach_m_s(CELL) == inf
