"""Traversal of the syntax tree of a program."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass

from sim.as_language.syntax import Program, ProgramStep


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


def steps_with_nodes(program: Program) -> Iterator[tuple[ProgramStep, object]]:
    """Yield every node of a program with its step."""
    for step in program.steps:
        for node in nodes(step.statement):
            yield step, node
