"""The table of instructions that are executed, against the words that the parser knows."""

from sim.as_language.keywords import EMULATED
from sim.controller.compile import INSTRUCTIONS


def test_the_instructions_that_are_executed_are_those_that_the_language_lists() -> None:
    """The check of a file reports all others."""
    assert set(INSTRUCTIONS) == EMULATED
