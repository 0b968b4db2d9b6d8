"""Table of all functions, and functions that inspect variables instead of values."""

from collections.abc import Mapping

from sim.as_language import functions_number, functions_pose, functions_text
from sim.as_language.functions import FunctionSignature
from sim.as_language.memory import Array, Namespace, VariableCell, index_of
from sim.as_language.values import Joints, Transformation, Value, truth

FUNCTIONS: Mapping[str, FunctionSignature] = {
    **functions_text.FUNCTIONS,
    **functions_number.FUNCTIONS,
    **functions_pose.FUNCTIONS,
}

NOT_AN_ARRAY, UNDEFINED_NAME = -1.0, -2.0

# EXISTxxx: prefix of the names, and type of the values.
EXISTS: Mapping[str, tuple[str, tuple[type, ...]]] = {
    "EXISTREAL": ("", (float,)),
    "EXISTTRANS": ("", (Transformation,)),
    "EXISTJOINT": ("#", (Joints,)),
    "EXISTCHAR": ("$", (str,)),
    "EXISTINTEGER": ("@", (int,)),
    "EXISTLOCALREAL": ("", (float,)),
    "EXISTLOCALTRANS": ("", (Transformation,)),
    "EXISTLOCALJOINT": ("#", (Joints,)),
    "EXISTLOCALCHAR": ("$", (str,)),
    "EXISTLOCALINTEGER": ("@", (int,)),
}
EXTREMES = {"MAXINDEX": max, "MININDEX": min}
MODIFYING = frozenset({"$DECODE", "$ENCODE"})
ALL_NAMES = frozenset({*FUNCTIONS, *EXISTS, *EXTREMES, *MODIFYING})


def exists(name: str, spelling: str, names: Namespace) -> float:
    """Return TRUE if a variable of the function's type is defined under a spelling."""
    prefix, kinds = EXISTS[name]
    base, _, rest = spelling.lower().lstrip(".").partition("[")
    entry = names.get(prefix + base.lstrip("$#@"))
    value: Value | None = None
    if isinstance(entry, VariableCell) and not rest:
        value = entry.value
    elif isinstance(entry, Array):
        if not rest.rstrip("] "):
            return truth(entry.defined)
        numbers = [float(number) for number in rest.rstrip("] ").split(",")]
        cell = entry.cells.get(index_of(numbers))
        value = None if cell is None else cell.value
    return truth(value.__class__ in kinds)


def extreme_index(name: str, spelling: str, dimension: int, names: Namespace) -> float:
    """Return MAXINDEX or MININDEX: -1 if the name is not an array, -2 if it is undefined."""
    base = spelling.lower().lstrip(".").partition("[")[0]
    entry = names.get(base)
    if isinstance(entry, Array):
        found = entry.indices(dimension)
        return float(EXTREMES[name](found)) if found else UNDEFINED_NAME
    return UNDEFINED_NAME if entry is None or entry.value is None else NOT_AN_ARRAY
