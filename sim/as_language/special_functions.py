"""Functions that inspect variables instead of values, and the names of all functions."""

from collections.abc import Mapping

from sim.as_language.errors import AsError
from sim.as_language.functions import FUNCTIONS
from sim.as_language.memory import Array, Namespace, VariableCell, plain
from sim.as_language.values import FALSE, Joints, Transformation, Value, truth

NOT_AN_ARRAY, UNDEFINED_NAME = -1.0, -2.0

# EXISTxxx and EXISTLOCALxxx: prefix of the names, and type of the values.
_KINDS = {
    "REAL": ("", float), "TRANS": ("", Transformation), "JOINT": ("#", Joints),
    "CHAR": ("$", str), "INTEGER": ("@", int),
}  # fmt: skip
EXISTS: Mapping[str, tuple[str, type]] = {
    f"EXIST{scope}{name}": kind for scope in ("", "LOCAL") for name, kind in _KINDS.items()
}
EXTREMES = {"MAXINDEX": max, "MININDEX": min}
# Letters of EXISTDATA.
DATA_TYPES = {
    "p": _KINDS["JOINT"], "t": _KINDS["TRANS"], "r": _KINDS["REAL"], "s": _KINDS["CHAR"],
    "i": _KINDS["INTEGER"],
}  # fmt: skip
A_PROGRAM = "g"
# Functions of a string with the name of a variable: types of its value, code if it is undefined.
NAMED: Mapping[str, tuple[tuple[type, ...], str]] = {
    "STRTOPOS": ((Transformation, Joints), "E0103"), "STRTOVAL": ((float, int), "E0102"),
}  # fmt: skip
MODIFYING = frozenset({"$DECODE", "$ENCODE"})
ALL_NAMES = frozenset({*FUNCTIONS, *EXISTS, *EXTREMES, *NAMED, *MODIFYING, "EXISTDATA"})


def named_value(name: str, spelling: str, names: Namespace) -> Value:
    """Return the value of STRTOPOS or STRTOVAL. Raises AsError E0103, E0102, P0118."""
    types, code = NAMED[name]
    value = names.read(spelling.lstrip("."))
    if value is None:
        raise AsError(code, spelling)
    if not isinstance(value, types):
        raise AsError("P0118", f"{name}: {spelling} is {plain(value)}")
    return value


def exists(type_of: tuple[str, type], spelling: str, names: Namespace) -> float:
    """Return TRUE if a variable of a type, as in EXISTS, is defined under a spelling."""
    prefix, kind = type_of
    spelled = prefix + spelling.lower().lstrip(".").lstrip("$#@")
    base, _, rest = spelled.partition("[")
    entry = names.get(base)
    if isinstance(entry, Array) and not rest.rstrip("] "):
        return truth(any(cell.value.__class__ is kind for cell in entry.cells.values()))
    if isinstance(entry, VariableCell) and rest:
        return FALSE
    return truth(names.read(spelled).__class__ is kind)


def extreme_index(name: str, spelling: str, dimension: int, names: Namespace) -> float:
    """Return MAXINDEX or MININDEX: -1 if the name is not an array, -2 if it is undefined."""
    base = spelling.lower().lstrip(".").partition("[")[0]
    entry = names.get(base)
    if isinstance(entry, Array):
        found = entry.indices(dimension)
        return float(EXTREMES[name](found)) if found else UNDEFINED_NAME
    return UNDEFINED_NAME if entry is None or entry.value is None else NOT_AN_ARRAY
