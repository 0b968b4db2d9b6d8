"""Compiler from expressions to closures: each takes an `EvaluationContext` and returns a value.

    expressions = Expressions()
    read = expressions.real(expression)       # once, when the program is loaded
    value = read(context)                     # each time the step is executed; raises AsError

`value`, `real`, `text`, `pose` and `place` select the result type; `store`, `refer` and `store_row`
are for variables that are written, passed by reference and filled; `layout` is for PRINT. Memory
and machine come from the context, so machines share compiled programs. Compilation never raises: an
error in an expression is raised when it is executed.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import attrgetter
from typing import cast

from sim.as_language import formats, functions_number, syntax, variables
from sim.as_language.errors import AsError
from sim.as_language.functions_text import decode
from sim.as_language.machine_api import EvaluationContext
from sim.as_language.memory import Array, Locals, VariableCell, bind, following, index_of, plain
from sim.as_language.operators import BINARY, UNARY
from sim.as_language.special_functions import (
    EXISTS,
    EXTREMES,
    FUNCTIONS,
    exists,
    extreme_index,
)
from sim.as_language.syntax import Expression, FunctionCall, Program, Variable
from sim.as_language.values import Joints, Pose, Transformation, Value, joints, text
from sim.as_language.variables import Indices, NamesOf, Read, Refer, Store

_locals_of: NamesOf = attrgetter("locals")
_globals_of: NamesOf = attrgetter("globals")


@dataclass(frozen=True, slots=True)
class ControllerOptions:
    """Options of a controller. `optional_formats`: /J /K /L."""

    optional_formats: bool = False


class Expressions:
    """Expression compiler."""

    def __init__(self, options: ControllerOptions | None = None) -> None:
        """Bind to the installed options of a controller."""
        self.options = options or ControllerOptions()

    # --- values -----------------------------------------------------------------------------------

    def value(self, expression: Expression, *, location: bool = False) -> Read:
        """Compile to a value of any type; `location`: an undefined name is E0103, not E0102."""
        match expression:
            case syntax.Number(value) | syntax.Text(value):
                return lambda _: value
            case syntax.Variable():
                return self._variable(expression, location=location)
            case syntax.Reference(variable):
                return self._variable(variable, location=location)
            case syntax.Binary():
                return self._binary(expression, location=location)
            case syntax.Unary(sign, operand):
                apply = UNARY[sign]
                read = self.value(operand, location=location and sign == "-")
                return lambda context: apply(read(context))
            case syntax.FunctionCall():
                return self._function(expression)
            case syntax.JointLiteral(values):
                readers = [self.real(item) for item in values]
                return lambda context: joints(*(read(context) for read in readers))
            case syntax.Word(name):
                return lambda _: name
            case syntax.Format(code):
                return refuse("P0114", f"/{code} is a format, not a value")

    def real(self, expression: Expression) -> Callable[[EvaluationContext], float]:
        """Compile to a number (P0118)."""
        if isinstance(expression, syntax.Number):
            constant = expression.value
            return lambda _: constant
        read = self.value(expression)
        if gives_number(expression):
            return cast("Callable[[EvaluationContext], float]", read)

        def run(context: EvaluationContext) -> float:
            value = read(context)
            if value.__class__ is float or isinstance(value, float | int):
                return value
            raise AsError("P0118", f"expected a number, found {plain(value)}")

        return run

    def text(self, expression: Expression) -> Callable[[EvaluationContext], str]:
        """Compile to a string (P0118)."""
        read = self.value(expression)

        def run(context: EvaluationContext) -> str:
            value = read(context)
            if isinstance(value, str):
                return value
            raise AsError("P0118", f"expected a string, found {plain(value)}")

        return run

    def pose(self, expression: Expression) -> Callable[[EvaluationContext], Pose]:
        """Compile to a transformation or joint values (E0103, P0118)."""
        read = self.value(expression, location=True)

        def run(context: EvaluationContext) -> Pose:
            value = read(context)
            if isinstance(value, Transformation | Joints):
                return value
            raise AsError("P0118", f"expected a location, found {plain(value)}")

        return run

    def place(self, expression: Expression) -> Callable[[EvaluationContext], Transformation]:
        """Compile to a transformation; the machine converts joint values."""
        read = self.pose(expression)

        def run(context: EvaluationContext) -> Transformation:
            value = read(context)
            if isinstance(value, Joints):
                return context.machine.transformation_of(value)
            return value

        return run

    # --- variables --------------------------------------------------------------------------------

    def store(self, variable: Variable) -> Store:
        """Compile to a writer of a variable or element (P0150, P0132, P0133)."""
        return variables.store(variable, _names_of(variable), self.indices(variable))

    def refer(
        self, expression: Expression | None
    ) -> Callable[[EvaluationContext], VariableCell | Array | None]:
        """Compile an argument of CALL: a variable by reference, or a new cell with a value."""
        if expression is None:
            return lambda _: None
        if isinstance(expression, syntax.Reference):
            expression = expression.variable
        if isinstance(expression, Variable):
            return self.refer_variable(expression)
        read = self.value(expression)
        return lambda context: VariableCell(read(context))

    def refer_variable(self, variable: Variable) -> Refer:
        """Compile to the cell or array of a variable."""
        return variables.refer(variable, _names_of(variable), self.indices(variable))

    def bind(
        self, arguments: Sequence[Expression | None]
    ) -> Callable[[EvaluationContext, Program], Locals]:
        """Compile the arguments of CALL to the locals of a program that receives them."""
        given = [self.refer(argument) for argument in arguments]
        return lambda context, program: bind(
            program.parameters, [read(context) for read in given], program.name
        )

    def store_row(self, variable: Variable) -> Callable[[EvaluationContext, Sequence[Value]], None]:
        """Compile to a writer of a sequence of values into consecutive elements."""
        locate = variables.locate(variable, _names_of(variable), self.indices(variable))

        def run(context: EvaluationContext, values: Sequence[Value]) -> None:
            array, index = locate(context)
            for count, value in enumerate(values):
                array.cell(following(index, count)).value = value

        return run

    def read_row(self, variable: Variable) -> Callable[[EvaluationContext, int], list[Value]]:
        """Compile to a reader of consecutive elements (E0102, E0104); a scalar is a row of one."""
        code = "E0104" if variable.kind == "$" else "E0102"
        if not variable.indices:
            read_scalar = self.value(variable)

            def only(context: EvaluationContext, count: int) -> list[Value]:
                value = read_scalar(context)
                if count > 1:
                    raise AsError(code, f"{variable.spelling} is one value, not 2")
                return [value]

            return only
        locate = variables.locate(variable, _names_of(variable), self.indices(variable))

        def run(context: EvaluationContext, count: int) -> list[Value]:
            array, index = locate(context)
            values = []
            for at in (following(index, k) for k in range(count)):
                value = array.cell(at).value
                if value is None:
                    raise AsError(code, f"{variable.spelling}[{at}]")
                values.append(value)
            return values

        return run

    def indices(self, variable: Variable) -> Indices | None:
        """Compile the indices in brackets; None without brackets."""
        if not variable.indices:
            return None
        numbers = [index.value for index in variable.indices if isinstance(index, syntax.Number)]
        if len(numbers) == len(variable.indices):
            with suppress(AsError):  # out of range: raised when it is executed
                constant = index_of(numbers)
                return lambda _: constant
        return variables.indices_of([self.value(index) for index in variable.indices])

    # --- text of PRINT and $ENCODE ----------------------------------------------------------------

    def layout(
        self, items: Sequence[Expression | None]
    ) -> Callable[[EvaluationContext], tuple[str, bool]]:
        """Compile items to their text, and whether a line feed follows."""
        parts = [
            item if isinstance(item, syntax.Format) else self.value(item)
            for item in items
            if item is not None
        ]
        return formats.layout(parts, optional=self.options.optional_formats)

    def _binary(self, expression: syntax.Binary, *, location: bool) -> Read:
        """Compile an operator; both operands are always evaluated, left first."""
        sign, right = expression.operator, expression.right
        apply, same = BINARY[sign], location and sign in "+-"
        first = self.value(expression.left, location=same)
        if isinstance(right, syntax.Number):
            constant = right.value
            return lambda context: apply(first(context), constant)
        second = self.value(right, location=same)
        return lambda context: apply(first(context), second(context))

    def _variable(self, variable: Variable, *, location: bool) -> Read:
        if variable.whole:
            return refuse("P0133", f"{variable.spelling}[] is a whole array")
        indices = self.indices(variable)
        names_of = _names_of(variable)
        if indices is None:
            return variables.read_scalar(variable, names_of, location=location)
        return variables.read_element(variable, names_of, indices, location=location)

    # --- functions --------------------------------------------------------------------------------

    def _function(self, call: FunctionCall) -> Read:
        """Compile a call; an unknown function or a wrong number of arguments raises when run."""
        if call.name == "$ENCODE":
            layout = self.layout(call.arguments)
            return lambda context: text(layout(context)[0])
        if call.name == "$DECODE":
            return self._decode(call)
        if call.name in EXISTS or call.name in EXTREMES:
            return self._lookup(call)
        function = FUNCTIONS.get(call.name)
        if function is None:
            return refuse("P0115", f"{call.name} is not emulated")
        try:
            function.check_count(call.name, len(call.arguments))
        except AsError as error:
            return refuse(error.code, error.detail)
        location = "p" in function.types or "t" in function.types
        return function.call(
            call.name,
            [
                (lambda _: None) if item is None else self.value(item, location=location)
                for item in call.arguments
            ],
        )

    def _decode(self, call: FunctionCall) -> Read:
        """Compile $DECODE: it removes the returned text from its variable."""
        target, separator, mode = (_argument(call, k) for k in range(3))
        if (
            not isinstance(target, Variable)
            or target.kind != "$"
            or separator is None
            or len(call.arguments) > 3
        ):
            return refuse("P0116", "$DECODE takes a string variable, a separator and a mode")
        read, store = self.text(target), self.store(target)
        mark, mode_of = self.text(separator), self.real(mode or syntax.Number(0.0))

        def run(context: EvaluationContext) -> Value:
            characters = read(context)
            taken, left = decode(characters, mark(context), mode_of(context))
            store(context, left)
            return taken

        return run

    def _lookup(self, call: FunctionCall) -> Read:
        """Compile EXISTxxx and MAXINDEX: of a variable, or of a string with its name."""
        name = call.name
        item, dimension = _argument(call, 0), _argument(call, 1)
        if item is None:
            return refuse("P0116", f"{name} takes a variable or a string with its name")
        spelling = self._spelling(name, item)
        dimension_of = self.real(dimension or syntax.Number(1.0))

        def run(context: EvaluationContext) -> Value:
            spelled = spelling(context)
            local = name.startswith("EXISTLOCAL") or spelled.startswith(".")
            names = context.locals if local else context.globals
            if name in EXISTS:
                return exists(name, spelled, names)
            return extreme_index(name, spelled, int(dimension_of(context)), names)

        return run

    def _spelling(self, name: str, item: Expression) -> Callable[[EvaluationContext], str]:
        """Compile the name to look up: that of the variable, or the content of a string."""
        if not isinstance(item, Variable) or (
            item.kind == "$" and not name.endswith("CHAR") and name not in EXTREMES
        ):
            return self.text(item)
        indices = self.indices(item)
        base = item.spelling
        if indices is None:
            return lambda _: base

        def spell(context: EvaluationContext) -> str:
            index = indices(context)
            numbers = index if isinstance(index, tuple) else (index,)
            return f"{base}[{','.join(map(str, numbers))}]"

        return spell


def _argument(call: FunctionCall, index: int) -> Expression | None:
    return call.arguments[index] if index < len(call.arguments) else None


def gives_number(expression: Expression) -> bool:
    """Return whether an expression can only yield a number, so no type check is needed."""
    match expression:
        case syntax.Number():
            return True
        case syntax.Binary(sign, left, right):
            return sign not in "+-" or gives_number(left) or gives_number(right)
        case syntax.Unary(sign, operand):
            return sign != "-" or gives_number(operand)
        case syntax.FunctionCall(name):
            return name in functions_number.FUNCTIONS
        case _:
            return False


def _names_of(variable: Variable) -> NamesOf:
    return _locals_of if variable.local else _globals_of


def refuse(code: str, detail: str) -> Read:
    """Return a reader that raises when it is executed."""

    def run(_: EvaluationContext) -> float:
        raise AsError(code, detail)

    return run
