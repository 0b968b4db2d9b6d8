"""The table of instructions that are executed, against the words that the parser knows."""

from sim.controller.compile import INSTRUCTIONS
from sim.controller.keywords import KNOWN


def test_every_instruction_that_is_executed_is_a_word_of_the_language() -> None:
    """The parser knows every instruction of the table."""
    assert set(INSTRUCTIONS) <= set(KNOWN)
