"""Signals of the simulated robot: outputs as switched, inputs that follow them."""

import pytest

from common.config.load import load_cell
from sim.robot.signals import SimSignals
from tests.fakes.bench import DEMO
from tests.fakes.signals import FOLLOWING


@pytest.mark.parametrize("on", [True, False])
def test_an_input_follows_its_output(on: bool) -> None:
    """In both directions; another output leaves it."""
    signals = SimSignals(load_cell(DEMO, FOLLOWING))
    signals.switch(10, not on)
    assert signals.switch(10, on) is None
    signals.switch(9, not on)
    assert signals.reading().on == {9: not on, 10: on, 11: False, 1001: on}
