"""The language of the AS emulator without its machine: evaluate, assign, parse one line."""

from types import SimpleNamespace
from typing import cast

import pytest

from sim.as_language import expressions, syntax
from sim.as_language.errors import AsError
from sim.as_language.lines import parse_line
from sim.as_language.machine_api import MachineInterface
from sim.as_language.memory import Locals, Namespace
from sim.as_language.parser import parse
from sim.as_language.values import Joints, Transformation, Value, joints

HERE = Transformation(1.0, 2.0, 3.0, 10.0, 20.0, 30.0)
HERE_JOINTS = Joints((1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
SWITCHES = {"cp": True, "power": False}


def standing_machine(signals: set[int], errors: list[int]) -> MachineInterface:
    """Return a controller at rest; the test sets its signals and its last error."""
    return cast("MachineInterface", SimpleNamespace(
        here=lambda: HERE,
        here_joints=lambda: HERE_JOINTS,
        destination=lambda: Transformation(9.0),
        destination_joints=lambda: joints(9.0),
        home_joints=lambda number: joints(float(number)),
        base=lambda: Transformation(z=100.0),
        tool=lambda: Transformation(z=50.0),
        transformation_of=lambda q: Transformation(*q.values),
        in_range=lambda place, _: 32768 if place.numbers()[0] > 1000.0 else 0,
        monitor_speed_percent=lambda: 10.0,
        motor_current_A=lambda joint: joint / 10.0,
        motor_torque_Nm=lambda joint: joint / 8.0,
        signal=lambda number: number in signals,
        switch=lambda name: SWITCHES[name],
        task_of=lambda name: 1 if name == "main" else -1,
        task_state=lambda number: int(number == 1),
        error_number=lambda: errors[-1],
        timer_s=lambda number: 0.5 * number,
        time_ms=lambda: "12:34:56.789",
        user_timer_s=lambda zero_ms: 5.0 - zero_ms * 1e-3,
        system_number=lambda *asked: float(sum(asked[1:]) + (asked[0] == "step")),
        system_text=str.upper,
        random=lambda: 0.25,
        date=lambda: "26/01/02",
        time=lambda: "12:34:56",
        has_program=lambda name: name == "main",
    ))  # fmt: skip


class AsLanguage:
    """Memory, locals of one call and a machine, for expressions and assignments."""

    def __init__(self, *assignments: str) -> None:
        self.memory = Namespace()
        self.locals = Locals()
        self.signals: set[int] = set()
        self.errors = [0]
        self.globals = self.memory
        self.machine = standing_machine(self.signals, self.errors)
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


def program(*lines: str) -> syntax.Program:
    """Parse a program of these lines."""
    return parse("\n".join([".PROGRAM p", *lines, ".END"])).programs["p"]
