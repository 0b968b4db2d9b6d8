"""Compiled programs: one closure for each step, in the order of the steps.

Compiled programs are independent of a machine: a step accesses all state through its task.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sim.as_language.syntax import Program, ProgramStep

if TYPE_CHECKING:
    from sim.controller.task import Task

Op = Callable[["Task"], int]
"""Executes a step for a task and returns the index of the next step."""


@dataclass(frozen=True, slots=True)
class Compiled:
    """Program with its compiled operations."""

    program: Program
    ops: Sequence[Op]

    @property
    def name(self) -> str:
        """Name of the program, lower case."""
        return self.program.name

    @property
    def steps(self) -> tuple[ProgramStep, ...]:
        """The parsed steps."""
        return self.program.steps
