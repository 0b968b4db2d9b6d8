"""The language of the AS emulator without its machine: evaluate, assign, parse one line."""

from types import SimpleNamespace
from typing import cast

import pytest

from sim.as_language import expressions, syntax
from sim.as_language.errors import AsError
from sim.as_language.lines import parse_line
from sim.as_language.machine_api import MachineInterface
from sim.as_language.memory import Locals, Namespace
from sim.as_language.values import Joints, Transformation, Value

HERE = Transformation(1.0, 2.0, 3.0, 10.0, 20.0, 30.0)
HERE_JOINTS = Joints((1.0, 2.0, 3.0, 4.0, 5.0, 6.0))


STANDING = cast("MachineInterface", SimpleNamespace(
    here=lambda: HERE,
    here_joints=lambda: HERE_JOINTS,
    transformation_of=lambda q: Transformation(*q.values),
    has_program=lambda name: name == "main",
))  # fmt: skip


class AsLanguage:
    """Memory, locals of one call and a machine, for expressions and assignments."""

    def __init__(self, *assignments: str, machine: MachineInterface | None = None) -> None:
        self.memory = Namespace()
        self.locals = Locals()
        self.globals = self.memory
        self.machine = machine or STANDING
        self.run(*assignments)

    def run(self, *assignments: str) -> "AsLanguage":
        """Execute `x = 1` and `POINT p = ...` steps."""
        for line in assignments:
            statement = parse_line(line).statement
            assert isinstance(statement, syntax.Assign | syntax.PointStatement)
            value = expressions.value_of(statement.value)(self)
            expressions.store(statement.target)(self, value)
        return self

    def __call__(self, text: str) -> Value:
        """Evaluate an expression."""
        return expressions.value_of(expression(text))(self)

    def outcome(self, text: str) -> Value:
        """Return the value of an expression, or the code of the error it raises."""
        try:
            return self(text)
        except AsError as error:
            return error.code

    def code(self, text: str) -> str:
        """Return the code of the error that an expression raises."""
        with pytest.raises(AsError) as caught:
            self(text)
        return caught.value.code


def expression(text: str) -> syntax.Expression:
    """Parse an expression."""
    statement = parse_line(f"x = {text}").statement
    assert isinstance(statement, syntax.Assign)
    return statement.value


def statement(text: str) -> syntax.Statement:
    """Parse a line; it must have a statement."""
    parsed = parse_line(text).statement
    assert parsed is not None
    return parsed
