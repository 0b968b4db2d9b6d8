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
from typing import Any, cast

from sim.as_language import formats, syntax
from sim.as_language.errors import AsError, refuse
from sim.as_language.functions import FUNCTIONS, NUMBER_FUNCTIONS, decode
from sim.as_language.machine_api import EvaluationContext, Read, ReadOf
from sim.as_language.memory import (
    Array,
    Index,
    Namespace,
    VariableCell,
    converted,
    following,
    index_of,
    key_of,
    plain,
    spelled,
    undefined,
)
from sim.as_language.operators import BINARY, UNARY
from sim.as_language.special_functions import (
    A_PROGRAM,
    DATA_TYPES,
    EXISTS,
    EXTREMES,
    NAMED,
    exists,
    extreme_index,
    named_value,
)
from sim.as_language.syntax import Expression, FunctionCall, Variable
from sim.as_language.values import (
    NUMBER,
    Joints,
    Pose,
    Transformation,
    Value,
    joints,
    text,
    truth,
)

ZERO, ONE = syntax.Number(0.0), syntax.Number(1.0)

Store = Callable[[EvaluationContext, Value], None]
Indices = ReadOf[Index]
NamesOf = ReadOf[Namespace]
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


def number_of(expression: Expression) -> ReadOf[float]:
    """Compile to a number (P0118)."""
    read = value_of(expression)
    if gives_number(expression):
        return cast("ReadOf[float]", read)
    return _checked(read, NUMBER, "a number")


def text_of(expression: Expression) -> ReadOf[str]:
    """Compile to a string (P0118)."""
    return _checked(value_of(expression), str, "a string")


def pose_of(expression: Expression) -> ReadOf[Pose]:
    """Compile to a transformation or joint values (E0103, P0118)."""
    return _checked(value_of(expression, location=True), (Transformation, Joints), "a location")


def _checked(read: Read, kinds: type | tuple[type, ...], name: str) -> Callable[..., Any]:
    """Return a reader that rejects values of other types."""

    def run(context: EvaluationContext) -> Value:
        value = read(context)
        if isinstance(value, kinds):
            return value
        raise AsError("P0118", f"expected {name}, found {plain(value)}")

    return run


def place_of(expression: Expression) -> ReadOf[Transformation]:
    """Compile to a transformation; the machine converts joint values."""
    read = pose_of(expression)

    def run(context: EvaluationContext) -> Transformation:
        value = read(context)
        if isinstance(value, Joints):
            return context.machine.transformation_of(value)
        return value

    return run


# --- variables --------------------------------------------------------------------------------


def _variable(variable: Variable, *, location: bool) -> Read:
    """Compile to a reader of a variable or element (E0102, E0103, E0104, P0132, P0133)."""
    if variable.whole:
        return refuse("P0133", f"{variable.spelling}[] is a whole array")
    key, names_of, indices = _place_of(variable)

    def read_scalar(context: EvaluationContext) -> Value:
        cell = names_of(context).get(key)
        if cell is not None and (value := cell.value) is not None:
            return value
        if isinstance(cell, Array) and cell.defined:
            raise AsError("P0133", f"{variable.spelling} is an array")
        raise undefined(variable, location=location)

    if indices is None:
        return read_scalar

    def read_element(context: EvaluationContext) -> Value:
        array = names_of(context).get(key)
        index = indices(context)
        if array.__class__ is Array:
            cell = array.cells.get(index)
            if cell is not None and (value := cell.value) is not None:
                return value
        elif array is not None and array.value is not None:
            raise AsError("P0132", f"{variable.spelling} has no elements")
        raise undefined(variable, index, location=location)

    return read_element


def store(variable: Variable) -> Store:
    """Compile to a writer of a variable or element (P0150, P0132, P0133)."""
    cell_of = _cell_of(variable)
    # Types that need no check while unchanged: only integers may need conversion.
    plain = () if variable.kind == "@" else (float, str, Transformation, Joints)

    def run(context: EvaluationContext, value: Value) -> None:
        cell = cell_of(context)
        if value.__class__ is cell.value.__class__ and value.__class__ in plain:
            cell.value = value
        else:
            cell.value = converted(variable, cell.value, value)

    return run


def refer(expression: Expression | None) -> ReadOf[VariableCell | Array | None]:
    """Compile an argument of CALL: a variable by reference, or a new cell with a value.

    The cell or array of a variable is created if it is missing.
    """
    if expression is None:
        return lambda _: None
    if isinstance(expression, syntax.Reference):
        expression = expression.variable
    if not isinstance(expression, Variable):
        read = value_of(expression)
        return lambda context: VariableCell(read(context))
    if not expression.whole:
        return _cell_of(expression)
    key, names_of, _ = _place_of(expression)
    return lambda context: names_of(context).array(key)


def _cell_of(variable: Variable) -> ReadOf[VariableCell]:
    key, names_of, indices = _place_of(variable)
    if indices is None:
        return lambda context: names_of(context).scalar(key)
    return lambda context: names_of(context).array(key).cell(indices(context))


def store_row(variable: Variable) -> Callable[[EvaluationContext, Sequence[Value]], None]:
    """Compile to a writer of a sequence of values into consecutive elements."""
    key, names_of, indices = _place_of(variable)

    def run(context: EvaluationContext, values: Sequence[Value]) -> None:
        array = names_of(context).array(key)
        first = 0 if indices is None else indices(context)
        for count, value in enumerate(values):
            array.cell(following(first, count)).value = value

    return run


def read_row(variable: Variable) -> Callable[[EvaluationContext, int], list[Value]]:
    """Compile to a reader of consecutive elements (E0102, E0104); a scalar is a row of one."""
    code = "E0104" if variable.kind == "$" else "E0102"
    key, names_of, indices = _place_of(variable)
    read_scalar = value_of(variable)

    def run(context: EvaluationContext, count: int) -> list[Value]:
        if indices is None:
            values = [read_scalar(context)]
            if count > 1:
                raise AsError(code, f"{variable.spelling} is one value, not 2")
            return values
        array = names_of(context).array(key)
        first, values = indices(context), []
        for at in (following(first, k) for k in range(count)):
            value = array.cell(at).value
            if value is None:
                raise AsError(code, f"{variable.spelling}[{at}]")
            values.append(value)
        return values

    return run


def _place_of(variable: Variable) -> tuple[str, NamesOf, Indices | None]:
    """Return the key of a variable, the namespace that holds it, and the reader of its index."""
    return key_of(variable), _locals_of if variable.local else _globals_of, _indices_of(variable)


def _indices_of(variable: Variable) -> Indices | None:
    """Compile the indices in brackets; None without brackets."""
    if not variable.indices:
        return None
    numbers = [index.value for index in variable.indices if isinstance(index, syntax.Number)]
    if len(numbers) == len(variable.indices):
        with suppress(AsError):  # out of range: raised when it is executed
            constant = index_of(numbers)
            return lambda _: constant
    return _computed_index([value_of(index) for index in variable.indices])


def _computed_index(readers: list[Read]) -> Indices:
    """Return a reader of one to three indices."""

    def number(value: Value) -> float:
        if isinstance(value, NUMBER):
            return value
        raise AsError("P0119", "an index must be a number")

    if len(readers) > 2:
        return lambda context: index_of([number(reader(context)) for reader in readers])
    first, second = readers[0], readers[-1]

    def single_index(context: EvaluationContext) -> Index:
        value = first(context)
        if value.__class__ is float and 0.0 <= value < 10000.0:
            return int(value)
        return index_of([number(value)])

    def pair(context: EvaluationContext) -> Index:
        a, b = number(first(context)), number(second(context))
        if 0.0 <= a < 10000.0 and 0.0 <= b < 10000.0:
            return int(a), int(b)
        return index_of([a, b])

    return pair if len(readers) == 2 else single_index


# --- text of PRINT and $ENCODE ----------------------------------------------------------------


def layout(items: Sequence[Expression | None]) -> ReadOf[tuple[str, bool]]:
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
    if call.name in NAMED or call.name == "EXISTDATA":
        return _named(call)
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
    match call.arguments:
        case (Variable(kind="$") as target, separator, *rest) if separator and len(rest) < 2:
            mode_of = number_of(rest[0] if rest and rest[0] else ZERO)
        case _:
            return refuse("P0116", "$DECODE takes a string variable, a separator and a mode")
    read, keep, mark = text_of(target), store(target), text_of(separator)

    def run(context: EvaluationContext) -> Value:
        characters = read(context)
        taken, left = decode(characters, mark(context), mode_of(context))
        keep(context, left)
        return taken

    return run


def _lookup(call: FunctionCall) -> Read:
    """Compile EXISTxxx and MAXINDEX: of a variable, or of a string with its name."""
    name = call.name
    item, dimension = (*call.arguments, None, None)[:2]
    if item is None:
        return refuse("P0116", f"{name} takes a variable or a string with its name")
    if isinstance(item, Variable) and (
        item.kind != "$" or name.endswith("CHAR") or name in EXTREMES
    ):
        spelling = _spelling(item)
    else:
        spelling = text_of(item)
    dimension_of = number_of(dimension or ONE)

    def run(context: EvaluationContext) -> Value:
        found = spelling(context)
        local = name.startswith("EXISTLOCAL") or found.startswith(".")
        names = context.locals if local else context.globals
        if name in EXISTS:
            return exists(EXISTS[name], found, names)
        return extreme_index(name, found, int(dimension_of(context)), names)

    return run


def _named(call: FunctionCall) -> Read:
    """Compile STRTOPOS, STRTOVAL and EXISTDATA: of a string with the name of a variable."""
    name = call.name
    match call.arguments:
        case (item,) if item is not None and name != "EXISTDATA":
            letter = ""
        case (item, syntax.Word(letter)) if item is not None and name == "EXISTDATA":
            pass
        case _:
            return refuse("P0116", f"{name} takes a string; EXISTDATA also P, T, R, S, I or G")
    if letter and letter != A_PROGRAM and letter not in DATA_TYPES:
        return refuse("P0116", f"EXISTDATA: the type is P, T, R, S, I or G, not {letter.upper()}")
    spelling = text_of(item)

    def run(context: EvaluationContext) -> Value:
        found = spelling(context)
        names = context.locals if found.startswith(".") else context.globals
        if letter == A_PROGRAM:
            return truth(context.machine.has_program(found.lower()))
        if letter:
            return exists(DATA_TYPES[letter], found, names)
        return named_value(name, found, names)

    return run


def _spelling(variable: Variable) -> ReadOf[str]:
    indices = _indices_of(variable)
    if indices is None:
        return lambda _: variable.spelling
    return lambda context: spelled(variable, indices(context))


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
            return name in NUMBER_FUNCTIONS
        case _:
            return False
