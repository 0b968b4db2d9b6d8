"""Memory model of AS: sparse arrays, globals shared by all programs, locals of one call.

    Cell      one variable or array element; `value` is None until it is defined
    Array     elements by index: an int for one dimension, a tuple for two or three
    Names     a namespace, from a spelling without index (`x`, `$s`, `#j`, `@n`) to Cell or Array;
              `Memory.globals` is one, the locals of each call are another (`Locals`)

Parameters are passed by reference: a name in the callee's Locals is bound to the caller's Cell or
Array. A name is either a scalar or an array (P0132, P0133) and, without prefix, either a real or a
transformation (P0150).
"""

from collections.abc import Iterable, Sequence

from sim.as_language.errors import AsError
from sim.as_language.syntax import DataValue, Number, Variable
from sim.as_language.values import Joints, Transformation, Value, joints, transformation

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
        found = [index for index, cell in self.cells.items() if cell.value is not None]
        tuples = [index if isinstance(index, tuple) else (index,) for index in found]
        return [index[dimension - 1] for index in tuples if len(index) >= dimension]

    @property
    def defined(self) -> bool:
        """Whether any element has a value."""
        return any(cell.value is not None for cell in self.cells.values())


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


Locals = Namespace


class Memory:
    """Global variables of a controller."""

    def __init__(self, data: Iterable[DataValue] = ()) -> None:
        """Initialise from the data sections of a file."""
        self.globals = Namespace()
        self.fill(data)

    def fill(self, data: Iterable[DataValue]) -> None:
        """Define variables from the lines of data sections."""
        for item in data:
            indices = [int(i.value) for i in item.variable.indices if isinstance(i, Number)]
            key = key_of(item.variable)
            cell = (
                self.globals.array(key).cell(index_of(indices))
                if indices
                else self.globals.scalar(key)
            )
            cell.value = _initial(item)

    def read(self, spelling: str) -> Value | None:
        """Return a global by its spelling, such as `$s` or `x[1,2]`; None if it is undefined."""
        name, _, rest = spelling.lower().partition("[")
        entry = self.globals.get(name)
        if not rest or isinstance(entry, VariableCell) or entry is None:
            return entry.value if isinstance(entry, VariableCell) and not rest else None
        cell = entry.cells.get(index_of([int(n) for n in rest.rstrip("]").split(",")]))
        return None if cell is None else cell.value

    def write(self, spelling: str, value: Value) -> None:
        """Define a global by its spelling, such as `$s` or `x[1,2]`."""
        name, _, rest = spelling.lower().partition("[")
        if not rest:
            self.globals.scalar(name).value = value
            return
        index = index_of([int(n) for n in rest.rstrip("]").split(",")])
        self.globals.array(name).cell(index).value = value


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
    if isinstance(index, int):
        further = index + count
        return further if further <= LARGEST_INDEX else index_of([further])
    return index_of([*index[:-1], index[-1] + count])


def undefined(variable: Variable, *, location: bool = False) -> AsError:
    """Return the error for an undefined variable: E0102, E0103 (location) or E0104 (string)."""
    code = "E0104" if variable.kind == "$" else "E0102"
    if variable.kind == "#" or (location and not variable.kind):
        code = "E0103"
    return AsError(code, variable.spelling)


def check_type(variable: Variable, old: Value | None, new: Value) -> None:
    """Reject a value of another type (P0150)."""
    if not isinstance(new, HOLDS[variable.kind]):
        raise AsError("P0150", f"{variable.spelling} cannot hold {plain(new)}")
    is_pose = isinstance(new, Transformation)
    if not variable.kind and old is not None and isinstance(old, Transformation) != is_pose:
        raise AsError("P0150", f"{variable.spelling} holds {plain(old)}, not {plain(new)}")


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


def _initial(item: DataValue) -> Value:
    value = item.value
    if isinstance(value, tuple):
        return joints(*value[:6]) if item.variable.kind == "#" else transformation(*value[:6])
    return int(value) if item.variable.kind == "@" and not isinstance(value, str) else value
