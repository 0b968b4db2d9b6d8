"""The table of instructions against the list that `--check` is silent about."""

from sim.controller.compile import INSTRUCTIONS
from sim.controller.keywords import EXECUTED


def test_what_check_calls_executed_is_executed() -> None:
    """No instruction passes the check and fails when it is reached."""
    assert set(INSTRUCTIONS) >= EXECUTED
