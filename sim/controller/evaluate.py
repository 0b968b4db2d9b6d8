"""Argument compiler for instructions: arguments as closures over a task."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from sim.as_language.errors import AsError
from sim.as_language.expressions import Expressions
from sim.as_language.machine_api import EvaluationContext
from sim.as_language.memory import Locals, bind, following
from sim.as_language.syntax import Expression, Instruction, Program, Variable
from sim.as_language.values import NUMBER, Joints, Transformation, Value, se3_of
from sim.as_language.variables import Store

Real = Callable[[EvaluationContext], float]
StoreAt = Callable[[EvaluationContext, int, Value], None]
"""Stores a value at an offset in elements from the element named in the program."""

_NULL = Transformation()


@dataclass(frozen=True, slots=True)
class Target:
    """Target of a motion: joint angles [rad], or the TOOL's pose in BASE."""

    q: Array | None = None
    T: pin.SE3 | None = None


class ArgumentCompiler:
    """Compiles the arguments of instructions."""

    def __init__(self, expressions: Expressions) -> None:
        """Bind to the expression compiler."""
        self._expressions = expressions
        self.real, self.text = expressions.real, expressions.text
        self.truth, self.pose, self.store = expressions.truth, expressions.pose, expressions.store

    def argument(self, statement: Instruction, index: int, default: float | None = None) -> Real:
        """Return a numeric argument; P0100 if it is omitted and has no default."""
        expression = _argument(statement, index)
        if expression is not None:
            return self.real(expression)
        if default is None:
            raise AsError("P0100", f"{statement.name} needs argument {index + 1}")
        return lambda _: default

    def target(self, expression: Expression | None) -> Callable[[EvaluationContext], Target]:
        """Return a reader of a motion target."""
        if expression is None:
            raise AsError("P0100", "a motion needs a location")
        read = self.pose(expression)

        def run(context: EvaluationContext) -> Target:
            value = read(context)
            if isinstance(value, Joints):
                return Target(q=np.radians(value.values))
            return Target(T=se3_of(value))

        return run

    def pose_or_null(
        self, expression: Expression | None
    ) -> Callable[[EvaluationContext], Transformation]:
        """Return a reader of a transformation; NULL if it is omitted."""
        return self._expressions.place(expression) if expression else lambda _: _NULL

    def variable(self, statement: Instruction, index: int) -> Variable:
        """Return a variable argument; P0118 if the argument is not a variable."""
        expression = _argument(statement, index)
        if not isinstance(expression, Variable):
            raise AsError("P0118", f"argument {index + 1} of {statement.name} must be a variable")
        return expression

    def result(self, statement: Instruction, index: int) -> Store:
        """Return a writer of a result variable."""
        return self.store(self.variable(statement, index))

    def results(self, statement: Instruction, index: int) -> StoreAt | None:
        """Return a writer of consecutive result elements; None if the argument is omitted."""
        if _argument(statement, index) is None:
            return None
        return self.store_at(self.variable(statement, index))

    def store_at(self, variable: Variable) -> StoreAt:
        """Return a writer of consecutive elements."""
        locate = self._expressions.locate(variable)

        def run(context: EvaluationContext, count: int, value: Value) -> None:
            array, index = locate(context)
            array.cell(following(index, count)).value = value

        return run

    def store_row(self, variable: Variable) -> Callable[[EvaluationContext, Sequence[Value]], None]:
        """Return a writer of a sequence of values into consecutive elements."""
        locate = self._expressions.locate(variable)

        def run(context: EvaluationContext, values: Sequence[Value]) -> None:
            array, index = locate(context)
            for count, value in enumerate(values):
                array.cell(following(index, count)).value = value

        return run

    def text_element(
        self, statement: Instruction, index: int
    ) -> Callable[[EvaluationContext, int], str]:
        """Return a reader of consecutive string elements (E0104)."""
        read = self._element(self.variable(statement, index), "E0104")

        def run(context: EvaluationContext, count: int) -> str:
            value = read(context, count)
            if not isinstance(value, str):
                raise AsError("P0118", f"{statement.name} needs strings")
            return value

        return run

    def element(
        self, statement: Instruction, index: int
    ) -> Callable[[EvaluationContext, int], float]:
        """Return a reader of consecutive numeric elements (E0102)."""
        read = self._element(self.variable(statement, index), "E0102")

        def run(context: EvaluationContext, count: int) -> float:
            value = read(context, count)
            if not isinstance(value, NUMBER):
                raise AsError("P0118", f"{statement.name} needs numbers")
            return value

        return run

    def arguments(
        self, expressions: Sequence[Expression | None]
    ) -> Callable[[EvaluationContext, Program], Locals]:
        """Return a function that binds the arguments of CALL to the parameters of a program."""
        given = [self._expressions.refer(expression) for expression in expressions]
        return lambda context, program: bind(
            program.parameters, [read(context) for read in given], program.name
        )

    def printed(
        self, items: Sequence[Expression | None]
    ) -> Callable[[EvaluationContext], tuple[str, bool]]:
        """Return the text of PRINT's items and whether a line feed follows."""
        return self._expressions.layout(items)

    def _element(self, variable: Variable, code: str) -> Callable[[EvaluationContext, int], Value]:
        if not variable.indices:  # a scalar is accepted as an array of one
            read_scalar = self._expressions.value(variable)
            return lambda context, count: _only(count, variable, code, read_scalar(context))
        locate = self._expressions.locate(variable)

        def run(context: EvaluationContext, count: int) -> Value:
            array, index = locate(context)
            at = following(index, count)
            value = array.cell(at).value
            if value is None:
                raise AsError(code, f"{variable.spelling}[{at}]")
            return value

        return run


def _only(count: int, variable: Variable, code: str, value: Value) -> Value:
    if count:
        raise AsError(code, f"{variable.spelling} is one value, not {count + 1}")
    return value


def _argument(statement: Instruction, index: int) -> Expression | None:
    return statement.arguments[index] if index < len(statement.arguments) else None
