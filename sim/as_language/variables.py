"""Compiler for variable access: read, store, and references for CALL and array instructions."""

from collections.abc import Callable

from sim.as_language.errors import AsError
from sim.as_language.machine_api import EvaluationContext
from sim.as_language.memory import (
    Array,
    Index,
    Namespace,
    VariableCell,
    check_type,
    index_of,
    key_of,
    undefined,
)
from sim.as_language.syntax import Variable
from sim.as_language.values import NUMBER, Joints, Transformation, Value, single

Read = Callable[[EvaluationContext], Value]
Store = Callable[[EvaluationContext, Value], None]
Refer = Callable[[EvaluationContext], VariableCell | Array]
Locate = Callable[[EvaluationContext], tuple[Array, Index]]
Indices = Callable[[EvaluationContext], Index]
NamesOf = Callable[[EvaluationContext], Namespace]
"""Namespace of a variable: the locals or the globals of the context."""


def read_scalar(variable: Variable, names_of: NamesOf, *, location: bool) -> Read:
    """Return a reader of a variable without index."""
    key = key_of(variable)

    def read(context: EvaluationContext) -> Value:
        cell = names_of(context).get(key)
        if cell is not None and (value := cell.value) is not None:
            return value
        raise missing(variable, cell, location=location)

    return read


def read_element(
    variable: Variable, names_of: NamesOf, indices: Indices, *, location: bool
) -> Read:
    """Return a reader of an array element."""
    key = key_of(variable)

    def read(context: EvaluationContext) -> Value:
        array = names_of(context).get(key)
        index = indices(context)
        if array.__class__ is Array:
            cell = array.cells.get(index)
            if cell is not None and (value := cell.value) is not None:
                return value
            raise undefined_element(variable, index, location=location)
        if array is not None and array.value is not None:
            raise AsError("P0132", f"{variable.spelling} has no elements")
        raise undefined_element(variable, index, location=location)

    return read


def refer(variable: Variable, names_of: NamesOf, indices: Indices | None) -> Refer:
    """Return a reference for a parameter: the cell or array itself, created if missing."""
    key = key_of(variable)
    if variable.whole:
        return lambda context: names_of(context).array(key)
    if indices is None:
        return lambda context: names_of(context).scalar(key)
    return lambda context: names_of(context).array(key).cell(indices(context))


def locate(variable: Variable, names_of: NamesOf, indices: Indices | None) -> Locate:
    """Return the array and first index for consecutive elements; without index: from element 0."""
    key = key_of(variable)
    at = indices if indices is not None else _first
    return lambda context: (names_of(context).array(key), at(context))


def store(variable: Variable, names_of: NamesOf, indices: Indices | None) -> Store:
    """Return a writer; it rejects other types (P0150, P0132, P0133)."""
    key = key_of(variable)
    # Types that need no check while unchanged: only integers may need conversion.
    plain = () if variable.kind == "@" else (float, str, Transformation, Joints)

    def keep(cell: VariableCell, value: Value) -> None:
        check_type(variable, cell.value, value)
        cell.value = converted(variable, value)

    def store_scalar(context: EvaluationContext, value: Value) -> None:
        names_here = names_of(context)
        cell = names_here.get(key)
        if cell is None or cell.__class__ is not VariableCell:
            cell = names_here.scalar(key)
        if value.__class__ is cell.value.__class__ and value.__class__ in plain:
            cell.value = value
        else:
            keep(cell, value)

    def store_element(context: EvaluationContext, value: Value) -> None:
        array = names_of(context).get(key)
        if array is None or array.__class__ is not Array:
            array = names_of(context).array(key)
        cell = array.cell(indices(context))  # type: ignore[misc]
        if value.__class__ is cell.value.__class__ and value.__class__ in plain:
            cell.value = value
        else:
            keep(cell, value)

    return store_scalar if indices is None else store_element


def converted(variable: Variable, value: Value) -> Value:
    """Convert a value to its variable's type: integer in `@n`, single precision in `x`."""
    if variable.kind == "@" and isinstance(value, NUMBER):
        whole = int(value)
        if not -(2**31) <= whole < 2**31:
            raise AsError("E0106", f"{variable.spelling} holds 32-bit integers, not {whole}")
        return whole
    if not variable.kind and isinstance(value, int):
        return single(float(value))
    return value


def indices_of(readers: list[Read]) -> Indices:
    """Return a reader of the index in brackets."""

    def number(value: Value) -> float:
        if isinstance(value, NUMBER):
            return value
        raise AsError("P0119", "an index must be a number")

    if len(readers) > 2:
        return lambda context: index_of([number(reader(context)) for reader in readers])
    only, *others = readers

    def single_index(context: EvaluationContext) -> Index:
        value = only(context)
        if value.__class__ is float and 0.0 <= value < 10000.0:
            return int(value)
        return index_of([number(value)])

    def pair(context: EvaluationContext) -> Index:
        a, b = number(only(context)), number(second(context))
        if 0.0 <= a < 10000.0 and 0.0 <= b < 10000.0:
            return int(a), int(b)
        return index_of([a, b])

    if not others:
        return single_index
    second = others[0]
    return pair


def missing(variable: Variable, entry: VariableCell | Array | None, *, location: bool) -> AsError:
    """Return the error for a variable that cannot be read."""
    if isinstance(entry, Array) and entry.defined:
        return AsError("P0133", f"{variable.spelling} is an array")
    return undefined(variable, location=location)


def undefined_element(variable: Variable, index: Index, *, location: bool) -> AsError:
    """Return the error for an undefined array element, with its index."""
    error = undefined(variable, location=location)
    numbers = index if isinstance(index, tuple) else (index,)
    return AsError(error.code, f"{variable.spelling}[{','.join(map(str, numbers))}]")


def _first(_: EvaluationContext) -> Index:
    return 0
