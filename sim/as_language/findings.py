"""Findings of `--check`: position, rule and message; and the steps in which rules look for them."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass

from sim.as_language.syntax import Position, Program, ProgramStep, SourceFile

# Rules for what the emulator parses but cannot execute.
NOT_EXECUTED = frozenset({"instruction", "function", "format"})


@dataclass(frozen=True, slots=True)
class LintFinding:
    """One finding: an unsupported construct or a warning."""

    where: Position
    rule: str
    text: str
    program: str = ""
    step: int = 0

    @property
    def kind(self) -> str:
        """`not executed` or `warning`."""
        return "not executed" if self.rule in NOT_EXECUTED else "warning"

    def __str__(self) -> str:
        place = f" ({self.program} step {self.step})" if self.step else ""
        return f"{self.where}: {self.kind}: {self.text} [{self.rule}]{place}"


def at(program: Program, step: ProgramStep, rule: str, text: str) -> LintFinding:
    """Return a finding at a step."""
    return LintFinding(step.where, rule, text, program.name, step.number)


def nodes(node: object) -> Iterator[object]:
    """Yield a statement or expression and everything inside it, outer ones first."""
    stack = [node]
    while stack:
        top = stack.pop()
        if isinstance(top, tuple):
            stack.extend(reversed(top))
        elif is_dataclass(top) and not isinstance(top, type):
            yield top
            stack.extend(getattr(top, field.name) for field in reversed(fields(top)))


def steps(source: SourceFile) -> Iterator[tuple[Program, ProgramStep]]:
    """Yield every step of a file with its program."""
    for program in source.programs.values():
        for step in program.steps:
            yield program, step
