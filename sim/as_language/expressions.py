"""Compiler from expressions to closures: each takes an `EvaluationContext` and returns a value.

    read = number_of(expression)       # once, when the program is loaded
    value = read(context)              # each time the step is executed; raises AsError

`value_of`, `number_of`, `text_of`, `pose_of`, `place_of` select the result type; `store`, `refer`,
and `store_row` are for variables that are written, passed by reference and filled; `layout` is for
PRINT. Memory and machine come from the context, so machines share compiled programs. Compilation
never raises: an error in an expression is raised when it is executed.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
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
from sim.as_language.variables import Indices, NamesOf, Read, Store

_locals_of: NamesOf = attrgetter("locals")
_globals_of: NamesOf = attrgetter("globals")


# --- values -----------------------------------------------------------------------------------


def value_of(expression: Expression, *, location: bool = False) -> Read:
    """Compile to a value of any type; `location`: an undefined name is E0103, not E0102."""
    match expression:
        case syntax.Number(value) | syntax.Text(value):
            return lambda _: value
        case syntax.Variable():
            return _variable(expression, location=location)
        case syntax.Reference(variable):
            return _variable(variable, location=location)
        case syntax.Binary():
            return _binary(expression, location=location)
        case syntax.Unary(sign, operand):
            apply = UNARY[sign]
            read = value_of(operand, location=location and sign == "-")
            return lambda context: apply(read(context))
        case syntax.FunctionCall():
            return _function(expression)
        case syntax.JointLiteral(values):
            readers = [number_of(item) for item in values]
            return lambda context: joints(*(read(context) for read in readers))
        case syntax.Word(name):
            return lambda _: name
        case syntax.Format(code):
            return refuse("P0114", f"/{code} is a format, not a value")


def number_of(expression: Expression) -> Callable[[EvaluationContext], float]:
    """Compile to a number (P0118)."""
    if isinstance(expression, syntax.Number):
        constant = expression.value
        return lambda _: constant
    read = value_of(expression)
    if gives_number(expression):
        return cast("Callable[[EvaluationContext], float]", read)

    def run(context: EvaluationContext) -> float:
        value = read(context)
        if value.__class__ is float or isinstance(value, float | int):
            return value
        raise AsError("P0118", f"expected a number, found {plain(value)}")

    return run


def text_of(expression: Expression) -> Callable[[EvaluationContext], str]:
    """Compile to a string (P0118)."""
    read = value_of(expression)

    def run(context: EvaluationContext) -> str:
        value = read(context)
        if isinstance(value, str):
            return value
        raise AsError("P0118", f"expected a string, found {plain(value)}")

    return run


def pose_of(expression: Expression) -> Callable[[EvaluationContext], Pose]:
    """Compile to a transformation or joint values (E0103, P0118)."""
    read = value_of(expression, location=True)

    def run(context: EvaluationContext) -> Pose:
        value = read(context)
        if isinstance(value, Transformation | Joints):
            return value
        raise AsError("P0118", f"expected a location, found {plain(value)}")

    return run


def place_of(expression: Expression) -> Callable[[EvaluationContext], Transformation]:
    """Compile to a transformation; the machine converts joint values."""
    read = pose_of(expression)

    def run(context: EvaluationContext) -> Transformation:
        value = read(context)
        if isinstance(value, Joints):
            return context.machine.transformation_of(value)
        return value

    return run


# --- variables --------------------------------------------------------------------------------


def store(variable: Variable) -> Store:
    """Compile to a writer of a variable or element (P0150, P0132, P0133)."""
    return variables.store(variable, _names_of(variable), index_of_variable(variable))


def refer(
    expression: Expression | None,
) -> Callable[[EvaluationContext], VariableCell | Array | None]:
    """Compile an argument of CALL: a variable by reference, or a new cell with a value."""
    if expression is None:
        return lambda _: None
    if isinstance(expression, syntax.Reference):
        expression = expression.variable
    if isinstance(expression, Variable):
        return variables.refer(expression, _names_of(expression), index_of_variable(expression))
    read = value_of(expression)
    return lambda context: VariableCell(read(context))


def bind_arguments(
    arguments: Sequence[Expression | None],
) -> Callable[[EvaluationContext, Program], Locals]:
    """Compile the arguments of CALL to the locals of a program that receives them."""
    given = [refer(argument) for argument in arguments]
    return lambda context, program: bind(
        program.parameters, [read(context) for read in given], program.name
    )


def store_row(variable: Variable) -> Callable[[EvaluationContext, Sequence[Value]], None]:
    """Compile to a writer of a sequence of values into consecutive elements."""
    locate = variables.locate(variable, _names_of(variable), index_of_variable(variable))

    def run(context: EvaluationContext, values: Sequence[Value]) -> None:
        array, index = locate(context)
        for count, value in enumerate(values):
            array.cell(following(index, count)).value = value

    return run


def read_row(variable: Variable) -> Callable[[EvaluationContext, int], list[Value]]:
    """Compile to a reader of consecutive elements (E0102, E0104); a scalar is a row of one."""
    code = "E0104" if variable.kind == "$" else "E0102"
    if not variable.indices:
        read_scalar = value_of(variable)

        def only(context: EvaluationContext, count: int) -> list[Value]:
            value = read_scalar(context)
            if count > 1:
                raise AsError(code, f"{variable.spelling} is one value, not 2")
            return [value]

        return only
    locate = variables.locate(variable, _names_of(variable), index_of_variable(variable))

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


def index_of_variable(variable: Variable) -> Indices | None:
    """Compile the indices in brackets; None without brackets."""
    if not variable.indices:
        return None
    numbers = [index.value for index in variable.indices if isinstance(index, syntax.Number)]
    if len(numbers) == len(variable.indices):
        with suppress(AsError):  # out of range: raised when it is executed
            constant = index_of(numbers)
            return lambda _: constant
    return variables.indices_of([value_of(index) for index in variable.indices])


# --- text of PRINT and $ENCODE ----------------------------------------------------------------


def layout(items: Sequence[Expression | None]) -> Callable[[EvaluationContext], tuple[str, bool]]:
    """Compile items to their text, and whether a line feed follows."""
    parts = [
        item if isinstance(item, syntax.Format) else value_of(item)
        for item in items
        if item is not None
    ]
    return formats.layout(parts)


def _binary(expression: syntax.Binary, *, location: bool) -> Read:
    """Compile an operator; both operands are always evaluated, left first."""
    sign, right = expression.operator, expression.right
    apply, same = BINARY[sign], location and sign in "+-"
    first = value_of(expression.left, location=same)
    if isinstance(right, syntax.Number):
        constant = right.value
        return lambda context: apply(first(context), constant)
    second = value_of(right, location=same)
    return lambda context: apply(first(context), second(context))


def _variable(variable: Variable, *, location: bool) -> Read:
    if variable.whole:
        return refuse("P0133", f"{variable.spelling}[] is a whole array")
    indices = index_of_variable(variable)
    names_of = _names_of(variable)
    if indices is None:
        return variables.read_scalar(variable, names_of, location=location)
    return variables.read_element(variable, names_of, indices, location=location)


# --- functions --------------------------------------------------------------------------------


def _function(call: FunctionCall) -> Read:
    """Compile a call; an unknown function or a wrong number of arguments raises when run."""
    if call.name == "$ENCODE":
        written = layout(call.arguments)
        return lambda context: text(written(context)[0])
    if call.name == "$DECODE":
        return _decode(call)
    if call.name in EXISTS or call.name in EXTREMES:
        return _lookup(call)
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
            (lambda _: None) if item is None else value_of(item, location=location)
            for item in call.arguments
        ],
    )


def _decode(call: FunctionCall) -> Read:
    """Compile $DECODE: it removes the returned text from its variable."""
    target, separator, mode = (_argument(call, k) for k in range(3))
    if (
        not isinstance(target, Variable)
        or target.kind != "$"
        or separator is None
        or len(call.arguments) > 3
    ):
        return refuse("P0116", "$DECODE takes a string variable, a separator and a mode")
    read, keep = text_of(target), store(target)
    mark, mode_of = text_of(separator), number_of(mode or syntax.Number(0.0))

    def run(context: EvaluationContext) -> Value:
        characters = read(context)
        taken, left = decode(characters, mark(context), mode_of(context))
        keep(context, left)
        return taken

    return run


def _lookup(call: FunctionCall) -> Read:
    """Compile EXISTxxx and MAXINDEX: of a variable, or of a string with its name."""
    name = call.name
    item, dimension = _argument(call, 0), _argument(call, 1)
    if item is None:
        return refuse("P0116", f"{name} takes a variable or a string with its name")
    spelling = _spelling(name, item)
    dimension_of = number_of(dimension or syntax.Number(1.0))

    def run(context: EvaluationContext) -> Value:
        spelled = spelling(context)
        local = name.startswith("EXISTLOCAL") or spelled.startswith(".")
        names = context.locals if local else context.globals
        if name in EXISTS:
            return exists(name, spelled, names)
        return extreme_index(name, spelled, int(dimension_of(context)), names)

    return run


def _spelling(name: str, item: Expression) -> Callable[[EvaluationContext], str]:
    """Compile the name to look up: that of the variable, or the content of a string."""
    if not isinstance(item, Variable) or (
        item.kind == "$" and not name.endswith("CHAR") and name not in EXTREMES
    ):
        return text_of(item)
    indices = index_of_variable(item)
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
