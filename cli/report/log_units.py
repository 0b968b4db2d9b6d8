"""Units of a force log: those of `--units`, and those in the names of its columns."""

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from forcemesh.errors import DataError

FORCE, TORQUE, TIME = "force", "torque", "time"


class LogUnit(NamedTuple):
    """A unit with its quantity and its factor to N, N m or s."""

    symbol: str
    quantity: str
    factor: float


# Pound-force and kilogram-force are exact by definition: NIST SP 811 (2008), appendix B.8.
LBF_N, KGF_N, INCH_M, FOOT_M = 4.4482216152605, 9.80665, 0.0254, 0.3048
UNITS: Mapping[str, LogUnit] = {
    unit.symbol: unit
    for unit in (
        LogUnit("N", FORCE, 1.0),
        LogUnit("mN", FORCE, 1e-3),
        LogUnit("kN", FORCE, 1e3),
        LogUnit("kgf", FORCE, KGF_N),
        LogUnit("gf", FORCE, 1e-3 * KGF_N),
        LogUnit("lbf", FORCE, LBF_N),
        LogUnit("Nm", TORQUE, 1.0),
        LogUnit("Nmm", TORQUE, 1e-3),
        LogUnit("mNm", TORQUE, 1e-3),
        LogUnit("Ncm", TORQUE, 1e-2),
        LogUnit("kNm", TORQUE, 1e3),
        LogUnit("lbf-in", TORQUE, LBF_N * INCH_M),
        LogUnit("lbf-ft", TORQUE, LBF_N * FOOT_M),
        LogUnit("s", TIME, 1.0),
        LogUnit("ms", TIME, 1e-3),
        LogUnit("us", TIME, 1e-6),
        LogUnit("ns", TIME, 1e-9),
        LogUnit("min", TIME, 60.0),
    )
}
DEFAULTS = {FORCE: UNITS["N"], TORQUE: UNITS["Nm"], TIME: UNITS["s"]}
SI_NAMES = {FORCE: "N", TORQUE: "N m", TIME: "s"}
IN_BRACKETS = re.compile(r"[\[(]([^\])]+)[\])]\s*$")
AT_THE_END = re.compile(r"_([A-Za-z]+)(?:\.\w+)?$")


def named_units(text: str) -> dict[str, LogUnit]:
    """Return the units of `--units` by quantity. Raises DataError for an unknown or second one."""
    found: dict[str, LogUnit] = {}
    for word in filter(None, (part.strip() for part in text.split(","))):
        unit = _unit(word)
        if unit is None:
            raise DataError(f"--units: unknown unit {word!r}: choose from {', '.join(UNITS)}")
        if unit.quantity in found:
            former = found[unit.quantity].symbol
            raise DataError(
                f"--units: {former} and {unit.symbol} are both units of {unit.quantity}"
            )
        found[unit.quantity] = unit
    return found


def unit_in_name(name: str, quantity: str) -> LogUnit | None:
    """Return the unit at the end of a column's name, as in `Fz [N]` or `time_ms`."""
    match = IN_BRACKETS.search(name) or AT_THE_END.search(name)
    unit = _unit(match[1]) if match else None
    return unit if unit is not None and unit.quantity == quantity else None


def unit_of_columns(names: Iterable[str], quantity: str, named: Mapping[str, LogUnit]) -> LogUnit:
    """Return the unit of columns: of `--units`, else of their names, else of the SI.

    Raises:
        DataError: The names of the columns give different units.
    """
    if quantity in named:
        return named[quantity]
    found = {unit for name in names if (unit := unit_in_name(name, quantity)) is not None}
    if len(found) > 1:
        symbols = " and ".join(sorted(unit.symbol for unit in found))
        raise DataError(f"the columns of {quantity} have the units {symbols}: name one in --units")
    return found.pop() if found else DEFAULTS[quantity]


def _unit(word: str) -> LogUnit | None:
    return UNITS.get(word.replace("µ", "u").replace("·", "").replace(" ", "").replace("*", ""))
