"""The tables of the compiler, against the words that the parser knows."""

from sim.as_language.keywords import EMULATED
from sim.as_language.special_functions import ALL_NAMES
from sim.controller.compile import DEAR, INSTRUCTIONS


def test_the_instructions_that_are_executed_are_those_that_the_language_lists() -> None:
    """The check of a file reports all others."""
    assert set(INSTRUCTIONS) == EMULATED


def test_every_word_of_a_dear_step_is_an_instruction_or_a_function() -> None:
    """A word that is neither would never count."""
    assert {*INSTRUCTIONS, *ALL_NAMES} >= DEAR
