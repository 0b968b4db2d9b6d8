"""Cell of the demo: whatever is asked of the controller, arming accepts its approach."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.demo.cell import DemoOverrides, demo_cell
from services.arbiter.preflight import contact_trips
from tests.fakes.bench import DEMO
from tuning.measured_range import SEGMENTS, segment_approach_m_s

OVER_TCP = DEMO.with_name("demo-tcp.yaml")


@pytest.mark.parametrize("row", SEGMENTS)
@settings(max_examples=5)
@given(st.floats(5e-5, 5e-4), st.floats(5e3, 3e4))
def test_the_approach_is_one_that_the_segments_bear(row, step_s, stiffness_N_m) -> None:
    """A fast controller has a short delay, which alone would permit a faster approach."""
    trial = DemoOverrides(
        as_step_s=step_s, stiffness_N_m=stiffness_N_m, least_segment_s=row.longest_s
    )
    cell = demo_cell(OVER_TCP, trial)
    assert list(contact_trips(cell)) == []
    assert cell.force.approach_m_s <= segment_approach_m_s(cell)


def test_a_cell_without_segments_approaches_as_the_gain_rule_permits() -> None:
    """The simulated robot has none."""
    cell = demo_cell(DEMO, DemoOverrides(stiffness_N_m=1e5))
    assert cell.force.approach_m_s == pytest.approx(cell.approach_limit_m_s)
