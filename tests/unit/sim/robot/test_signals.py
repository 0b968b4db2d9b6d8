"""Signals of the simulated robot: outputs as switched, inputs that follow them."""

import pytest

from common.config.load import load_cell
from sim.robot.signals import SimSignals
from tests.fakes.bench import CELL, DEMO
from tests.fakes.signals import FOLLOWING, NAMED


def test_all_are_off_at_first() -> None:
    """Every named signal is known, and no other."""
    signals = SimSignals(load_cell(DEMO, {"signals": NAMED}))
    assert signals.reading().on == {9: False, 10: False, 11: False, 1001: False}
    assert SimSignals(CELL).reading().on == {}


@pytest.mark.parametrize("on", [True, False])
def test_an_input_follows_its_output(on: bool) -> None:
    """In both directions; another output leaves it."""
    signals = SimSignals(load_cell(DEMO, FOLLOWING))
    signals.switch(10, not on)
    assert signals.switch(10, on) is None
    signals.switch(9, not on)
    assert signals.reading().on == {9: not on, 10: on, 11: False, 1001: on}
