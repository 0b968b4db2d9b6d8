"""The table of instructions that are executed, against the words that the parser knows."""

from sim.controller.compile import INSTRUCTIONS
from sim.controller.keywords import KNOWN


def test_every_instruction_that_is_executed_is_a_word_of_the_language() -> None:
    """Nothing in the table is unreachable because the parser does not know it."""
    assert set(INSTRUCTIONS) <= set(KNOWN)
