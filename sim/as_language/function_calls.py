"""Compiler for function calls, including functions that modify or look up a variable."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sim.as_language.errors import AsError
from sim.as_language.functions import Argument
from sim.as_language.functions_number import rounded
from sim.as_language.functions_text import decode
from sim.as_language.special_functions import EXISTS, EXTREMES, FUNCTIONS, exists, extreme_index
from sim.as_language.syntax import Expression, FunctionCall, Variable
from sim.as_language.values import Value, text

if TYPE_CHECKING:
    from sim.as_language.expressions import Expressions
    from sim.as_language.functions import FunctionSignature
    from sim.as_language.machine_api import EvaluationContext
    from sim.as_language.variables import Read

    ReadArgument = Callable[[EvaluationContext], Argument]

# Fast path for one single-precision real argument: equivalent Python functions.
OF_REAL: dict[str, Callable[[float], float]] = {"ABS": abs, "ROUND": rounded}


def compile_function(expressions: Expressions, call: FunctionCall) -> Read:
    """Compile a call; an unknown function or a wrong number of arguments raises when executed."""
    if call.name == "$ENCODE":
        layout = expressions.layout(call.arguments)
        return lambda context: text(layout(context)[0])
    if call.name == "$DECODE":
        return _decode(expressions, call)
    if call.name in EXISTS or call.name in EXTREMES:
        return _array_reader(expressions, call)
    return _computed(expressions, call)


def _computed(expressions: Expressions, call: FunctionCall) -> Read:
    function = FUNCTIONS.get(call.name)
    if function is None:
        return _refuse("P0115", f"{call.name} is not emulated")
    try:
        function.check_count(len(call.arguments))
    except AsError as error:
        return _refuse(error.code, error.detail)
    location = "p" in function.types or "t" in function.types
    readers = [_reader(expressions, item, location=location) for item in call.arguments]
    if len(readers) == 1:
        return _of_one(function, readers[0])
    if len(readers) == 2:
        return _of_two(function, *readers)
    if len(readers) == 3:
        return _of_three(function, *readers)
    compute, check = function.compute, function.check
    # `check` depends only on types: a type combination that passed once always passes.
    passed: set[tuple[type, ...]] = set()

    def run(context: EvaluationContext) -> Value:
        arguments = [read(context) for read in readers]
        types = tuple(map(type, arguments))
        if types not in passed:
            check(arguments)
            passed.add(types)
        return compute(context.machine, arguments)

    return run


def _of_one(function: FunctionSignature, only: ReadArgument) -> Read:
    compute, check, of_real = function.compute, function.check, OF_REAL.get(function.name)
    passed: set[type] = set()

    def run(context: EvaluationContext) -> Value:
        argument = only(context)
        if argument.__class__ not in passed:
            check((argument,))
            passed.add(argument.__class__)
        return compute(context.machine, (argument,))

    def run_of_real(context: EvaluationContext) -> Value:
        argument = only(context)
        if argument.__class__ is float:
            return of_real(argument)  # type: ignore[misc]
        check((argument,))
        return compute(context.machine, (argument,))

    return run if of_real is None else run_of_real


def _of_two(function: FunctionSignature, first: ReadArgument, second: ReadArgument) -> Read:
    compute, check = function.compute, function.check
    passed: set[tuple[type, type]] = set()

    def run(context: EvaluationContext) -> Value:
        a, b = arguments = first(context), second(context)
        types = a.__class__, b.__class__
        if types not in passed:
            check(arguments)
            passed.add(types)
        return compute(context.machine, arguments)

    return run


def _of_three(
    function: FunctionSignature, first: ReadArgument, second: ReadArgument, third: ReadArgument
) -> Read:
    compute, check = function.compute, function.check
    passed: set[tuple[type, type, type]] = set()

    def run(context: EvaluationContext) -> Value:
        a, b, c = arguments = first(context), second(context), third(context)
        types = a.__class__, b.__class__, c.__class__
        if types not in passed:
            check(arguments)
            passed.add(types)
        return compute(context.machine, arguments)

    return run


def _reader(expressions: Expressions, item: Expression | None, *, location: bool) -> ReadArgument:
    if item is None:
        return lambda _: None
    return expressions.value(item, location=location)


def _decode(expressions: Expressions, call: FunctionCall) -> Read:
    """Compile $DECODE: it removes the returned text from its variable."""
    if not 2 <= len(call.arguments) <= 3:
        return _refuse("P0116", "$DECODE takes a string variable, a separator and a mode")
    target, separator, *rest = call.arguments
    if not isinstance(target, Variable) or target.kind != "$" or separator is None:
        return _refuse("P0116", "$DECODE takes a string variable, a separator and a mode")
    read, store = expressions.text(target), expressions.store(target)
    mark = expressions.text(separator)
    mode = expressions.real(rest[0]) if rest and rest[0] is not None else _zero

    def run(context: EvaluationContext) -> Value:
        characters = read(context)
        taken, left = decode(characters, mark(context), mode(context))
        store(context, left)
        return taken

    return run


def _array_reader(expressions: Expressions, call: FunctionCall) -> Read:
    """Compile EXISTxxx and MAXINDEX: their argument is a variable, or a string with its name."""
    if not call.arguments or call.arguments[0] is None:
        return _refuse("P0116", f"{call.name} takes a variable or a string with its name")
    spelling = _spelling(expressions, call.name, call.arguments[0])
    always_local = call.name.startswith("EXISTLOCAL")
    dimension = _dimension(expressions, call)
    name, is_exists = call.name, call.name in EXISTS

    def run(context: EvaluationContext) -> Value:
        spelled = spelling(context)
        local = always_local or spelled.startswith(".")
        names = context.locals if local else context.globals
        if is_exists:
            return exists(name, spelled, names)
        return extreme_index(name, spelled, int(dimension(context)), names)

    return run


def _spelling(
    expressions: Expressions, name: str, item: Expression
) -> Callable[[EvaluationContext], str]:
    """Compile the name to look up: that of the variable, or the content of a string."""
    own = isinstance(item, Variable) and (
        item.kind != "$" or name.endswith("CHAR") or name in EXTREMES
    )
    if not isinstance(item, Variable) or not own:
        return expressions.text(item)
    indices = expressions.indices(item)
    base = item.spelling
    if indices is None:
        return lambda _: base

    def spell(context: EvaluationContext) -> str:
        index = indices(context)
        numbers = index if isinstance(index, tuple) else (index,)
        return f"{base}[{','.join(map(str, numbers))}]"

    return spell


def _dimension(
    expressions: Expressions, call: FunctionCall
) -> Callable[[EvaluationContext], float]:
    given = call.arguments[1] if len(call.arguments) > 1 else None
    return _one if given is None else expressions.real(given)


def _zero(_: EvaluationContext) -> float:
    return 0.0


def _one(_: EvaluationContext) -> float:
    return 1.0


def _refuse(code: str, detail: str) -> Read:
    def run(_: EvaluationContext) -> float:
        raise AsError(code, detail)

    return run
