"""Findings of `--check`: position, rule and message."""

from dataclasses import dataclass
from typing import Literal

from sim.as_language.syntax import Position, Program, ProgramStep

Kind = Literal["not executed", "warning"]


@dataclass(frozen=True, slots=True)
class LintFinding:
    """One finding: an unsupported construct or a warning."""

    where: Position
    rule: str
    text: str
    kind: Kind = "warning"
    program: str = ""
    step: int = 0

    def __str__(self) -> str:
        place = f" ({self.program} step {self.step})" if self.step else ""
        return f"{self.where}: {self.kind}: {self.text} [{self.rule}]{place}"


def at(
    program: Program, step: ProgramStep, rule: str, text: str, *, kind: Kind = "warning"
) -> LintFinding:
    """Return a finding at a step."""
    return LintFinding(step.where, rule, text, kind, program.name, step.number)
