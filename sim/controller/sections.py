"""Data sections of a saved file: .REALS, .STRINGS, .INTEGER, .TRANS and .JOINTS."""

import re

from sim.controller import syntax
from sim.controller.builder import short_name
from sim.controller.errors import AsError
from sim.controller.lines import LineError
from sim.controller.syntax import Position
from sim.controller.values import single

DATA_SECTIONS = frozenset({".REALS", ".STRINGS", ".INTEGER", ".TRANS", ".JOINTS"})
ITEM = re.compile(
    r"(?P<kind>[$#@]?)(?P<name>[A-Za-z][\w.]*)\s*(\[(?P<indices>[\d\s,]+)\])?\s*=?\s*(?P<value>.*)",
    re.ASCII,
)
KINDS = {".REALS": "", ".STRINGS": "$", ".INTEGER": "@", ".TRANS": "", ".JOINTS": "#"}


def data_line(section: str, line: str, where: Position) -> syntax.DataValue:
    """Return the value on one line of a data section; raise `LineError`."""
    match = ITEM.match(line.strip())
    if match is None:
        raise LineError("P0108", f"{section}: expected a name and its value; found {line!a:.60}")
    kind = KINDS[section]
    if match["kind"] not in ("", kind):
        raise LineError("P0118", f"{section} holds names with {kind!r}, found {match['kind']!r}")
    indices = tuple(syntax.Number(float(n)) for n in (match["indices"] or "").split(",") if n)
    variable = syntax.Variable(kind, short_name(match["name"]), indices=indices)
    return syntax.DataValue(variable, _value(section, match["value"].strip()), where)


def _value(section: str, spelled: str) -> float | str | tuple[float, ...]:
    if section == ".STRINGS":
        if len(spelled) < 2 or spelled[0] != '"' or spelled[-1] != '"':
            raise LineError("P0108", f"expected a quoted string; found {spelled!a:.60}")
        return spelled[1:-1]
    try:
        numbers = tuple(float(word) for word in spelled.replace(",", " ").split())
        if section == ".INTEGER":
            return float(int(numbers[0]))
        rounded = tuple(single(number) for number in numbers)
    except (ValueError, IndexError, OverflowError, AsError):
        raise LineError("P0100", f"{section}: expected numbers; found {spelled!a:.60}") from None
    if section == ".REALS":
        if len(rounded) != 1:
            raise LineError("P0100", f"expected one number; found {spelled!a:.60}")
        return rounded[0]
    if len(rounded) < 6:
        raise LineError("P0100", f"expected six numbers for a pose; found {len(rounded)}")
    return rounded
