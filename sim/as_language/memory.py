"""Memory model of AS: sparse arrays, globals shared by all programs, locals of one call.

    Cell      one variable or array element; `value` is None until it is defined
    Array     elements by index: an int for one dimension, a tuple for two or three
    Names     a namespace, from a spelling without index (`x`, `$s`, `#j`, `@n`) to Cell or Array;
              the global variables are one, the locals of each call are another (`Locals`)

Parameters are passed by reference: a name in the callee's Locals is bound to the caller's Cell or
Array. A name is either a scalar or an array (P0132, P0133) and, without prefix, either a real or a
transformation (P0150).
"""

from collections.abc import Iterable, Sequence

from sim.as_language.errors import AsError
from sim.as_language.syntax import DataValue, Number, Variable
from sim.as_language.values import (
    NUMBER,
    Joints,
    Transformation,
    Value,
    joints,
    single,
    transformation,
)

LARGEST_INDEX = 9999

# Permitted types of a variable, by the first character of its spelling.
HOLDS: dict[str, tuple[type, ...]] = {
    "$": (str,), "#": (Joints,), "@": (int, float), "": (float, int, Transformation),
}  # fmt: skip

Index = int | tuple[int, ...]


class VariableCell:
    """One variable or array element."""

    __slots__ = ("value",)

    def __init__(self, value: Value | None = None) -> None:
        """Create a cell, undefined unless a value is given."""
        self.value = value


class Array:
    """Sparse array: elements by index, created on first use."""

    __slots__ = ("cells",)
    value = None  # lets the fast path of scalar readers fall through to the error path

    def __init__(self) -> None:
        """Create an empty array."""
        self.cells: dict[Index, VariableCell] = {}

    def cell(self, index: Index) -> VariableCell:
        """Return an element, undefined if it is new."""
        found = self.cells.get(index)
        if found is None:
            found = self.cells[index] = VariableCell()
        return found

    def indices(self, dimension: int = 1) -> list[int]:
        """Return the indices of the defined elements in a dimension, unordered."""
        tuples = [
            index if isinstance(index, tuple) else (index,)
            for index, cell in self.cells.items()
            if cell.value is not None
        ]
        return [index[dimension - 1] for index in tuples if len(index) >= dimension]

    @property
    def defined(self) -> bool:
        """Whether any element has a value."""
        return bool(self.indices())


class Namespace(dict[str, VariableCell | Array]):
    """A namespace: spelling without index and without the dot of locals -> Cell or Array."""

    __slots__ = ()

    def scalar(self, key: str) -> VariableCell:
        """Return a variable, undefined if it is new; P0133 if the name is an array."""
        found = self.get(key)
        if isinstance(found, VariableCell):
            return found
        if found is not None and found.defined:
            raise AsError("P0133", f"{key} is an array")
        cell = self[key] = VariableCell()
        return cell

    def array(self, key: str) -> Array:
        """Return an array, empty if it is new; P0132 if the name is a scalar."""
        found = self.get(key)
        if isinstance(found, Array):
            return found
        if found is not None and found.value is not None:
            raise AsError("P0132", f"{key} has no elements, it is a single variable")
        array = self[key] = Array()
        return array

    def fill(self, data: Iterable[DataValue]) -> None:
        """Define variables from the lines of data sections."""
        for item in data:
            variable, given = item.variable, item.value
            indices = [index.value for index in variable.indices if isinstance(index, Number)]
            cell = self._cell(key_of(variable), indices)
            if isinstance(given, tuple):
                cell.value = (joints if variable.kind == "#" else transformation)(*given[:6])
            else:
                cell.value = int(given) if variable.kind == "@" else given

    def read(self, spelling: str) -> Value | None:
        """Return the value under a spelling, such as `$s` or `x[1,2]`; None if it is undefined."""
        key, numbers = _parts(spelling)
        entry = self.get(key)
        if numbers:
            entry = entry.cells.get(index_of(numbers)) if isinstance(entry, Array) else None
        return None if entry is None else entry.value

    def write(self, spelling: str, value: Value) -> None:
        """Define a variable by its spelling, such as `$s` or `x[1,2]`."""
        key, numbers = _parts(spelling)
        self._cell(key, numbers).value = value

    def _cell(self, key: str, indices: Sequence[float]) -> VariableCell:
        if not indices:
            return self.scalar(key)
        return self.array(key).cell(index_of(indices))


Locals = Namespace


def _parts(spelling: str) -> tuple[str, list[float]]:
    key, _, rest = spelling.lower().partition("[")
    indices = rest.rstrip("] ")
    try:
        return key, [float(number) for number in indices.split(",")] if indices else []
    except ValueError:
        raise AsError("P0119", f"{spelling}: an index must be a number") from None


def key_of(variable: Variable) -> str:
    """Return the key of a variable in its namespace."""
    return f"{variable.kind}{variable.name}"


def index_of(numbers: Sequence[float]) -> Index:
    """Return an array index: integers 0 to 9999 (P0119); fractions are truncated."""
    whole = tuple(map(int, numbers))
    if min(whole) < 0 or max(whole) > LARGEST_INDEX:
        raise AsError("P0119", f"{list(numbers)}: indices are 0 to {LARGEST_INDEX}")
    return whole if len(whole) > 1 else whole[0]


def following(index: Index, count: int) -> Index:
    """Return the index `count` elements further in the last dimension."""
    *others, last = index if isinstance(index, tuple) else (index,)
    return index_of([*others, last + count])


def spelled(variable: Variable, index: Index) -> str:
    """Return an array element as AS writes it: `.$s[1,2]`."""
    numbers = index if isinstance(index, tuple) else (index,)
    return f"{variable.spelling}[{','.join(map(str, numbers))}]"


def undefined(variable: Variable, index: Index | None = None, *, location: bool) -> AsError:
    """Return the error for an undefined name: E0102, E0103 (location) or E0104 (string)."""
    code = "E0104" if variable.kind == "$" else "E0102"
    if variable.kind == "#" or (location and not variable.kind):
        code = "E0103"
    return AsError(code, variable.spelling if index is None else spelled(variable, index))


def converted(variable: Variable, old: Value | None, new: Value) -> Value:
    """Return a value as its variable holds it: an integer in `@n`, single precision in `x`.

    Raises AsError P0150 for a value of another type, E0106 for an integer out of range.
    """
    if not isinstance(new, HOLDS[variable.kind]):
        raise AsError("P0150", f"{variable.spelling} cannot hold {plain(new)}")
    is_pose = isinstance(new, Transformation)
    if not variable.kind and old is not None and isinstance(old, Transformation) != is_pose:
        raise AsError("P0150", f"{variable.spelling} holds {plain(old)}, not {plain(new)}")
    if variable.kind == "@" and isinstance(new, NUMBER):
        whole = int(new)
        if not -(2**31) <= whole < 2**31:
            raise AsError("E0106", f"{variable.spelling} holds 32-bit integers, not {whole}")
        return whole
    return single(float(new)) if isinstance(new, int) else new


def plain(value: Value) -> str:
    """Return the type of a value for a message."""
    if isinstance(value, str):
        return "a string"
    if isinstance(value, Transformation):
        return "a transformation"
    return "joint values" if isinstance(value, Joints) else "a number"


def bind(
    parameters: Sequence[Variable], arguments: Sequence[VariableCell | Array | None], program: str
) -> Locals:
    """Return the locals of a call, its parameters bound to the arguments.

    Raises:
        AsError: P0137 for their number, P0138 for a type. None (omitted) is undefined.
    """
    if len(arguments) != len(parameters):
        text = f"{program} takes {len(parameters)} arguments, not {len(arguments)}"
        raise AsError("P0137", text)
    names = Locals()
    for number, (parameter, given) in enumerate(zip(parameters, arguments, strict=True), start=1):
        entry = given
        if entry is None:
            entry = Array() if parameter.whole else VariableCell()
        if isinstance(entry, Array) != parameter.whole:
            what = "an array" if parameter.whole else "a single value"
            raise AsError("P0138", f"argument {number} of {program} must be {what}")
        value = entry.value
        if value is not None and not isinstance(value, HOLDS[parameter.kind]):
            text = f"argument {number} of {program} is {plain(value)}"
            raise AsError("P0138", f"{text}, the parameter {parameter.spelling} is not")
        names[key_of(parameter)] = entry
    return names
