"""Programs that can be executed: one closure for each step, in the order of the steps.

Nothing here belongs to one machine: what a step reads and moves, it finds at the task.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sim.controller.syntax import Program, Step

if TYPE_CHECKING:
    from sim.controller.task import Task

Op = Callable[["Task"], int]
"""Executes a step for a task and returns the index of the step to go on with."""


@dataclass(frozen=True, slots=True)
class Compiled:
    """A program and its operations."""

    program: Program
    ops: Sequence[Op]

    @property
    def name(self) -> str:
        """Name of the program, lower case."""
        return self.program.name

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps as written."""
        return self.program.steps
