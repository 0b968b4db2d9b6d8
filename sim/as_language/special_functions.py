"""Functions that inspect variables instead of values, and the names of all functions."""

from collections.abc import Mapping

from sim.as_language.functions import FUNCTIONS
from sim.as_language.memory import Array, Namespace, VariableCell
from sim.as_language.values import FALSE, Joints, Transformation, truth

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
MODIFYING = frozenset({"$DECODE", "$ENCODE"})
ALL_NAMES = frozenset({*FUNCTIONS, *EXISTS, *EXTREMES, *MODIFYING})


def exists(name: str, spelling: str, names: Namespace) -> float:
    """Return TRUE if a variable of the function's type is defined under a spelling."""
    prefix, kind = EXISTS[name]
    spelled = prefix + spelling.lower().lstrip(".").lstrip("$#@")
    base, _, rest = spelled.partition("[")
    entry = names.get(base)
    if isinstance(entry, Array) and not rest.rstrip("] "):
        return truth(entry.defined)
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
