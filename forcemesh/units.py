"""Plausible ranges of cell file values, and the unit error that a value outside them suggests.

Pure: only names, numbers and texts, so that it loads fast in every verb.
"""

from collections.abc import Mapping
from math import degrees, hypot, pi
from typing import Any, NamedTuple

MOUNTING_MOST_RAD = 0.2  # a fit corrects mounting tolerance, not a wrong orientation
COUNTS_MOST = 2**31 - 1  # an RDT reading is a signed number of 32 bits
LONGEST_LEVER_M = 1.0  # torque range over force range of a sensor: 8 to 160 mm on the market
MOST_RADIANS = 2.0 * pi + 1e-3  # in degrees, no joint range of an arm is this small
SLOWEST_DEG_S = 20.0  # no joint of an arm is this slow


class Wrong(NamedTuple):
    """Another common unit of the same quantity."""

    name: str
    factor: float  # conversion to the right unit


class Unit(NamedTuple):
    """The unit at the end of a field's name."""

    symbol: str
    wrongs: tuple[Wrong, ...]


MM, MS, GRAM = Wrong("millimetres", 1e-3), Wrong("milliseconds", 1e-3), Wrong("grams", 1e-3)
MILLIDEGREES, MILLIRADIANS = Wrong("thousandths of a degree", 1e-3), Wrong("milliradians", 1e-3)
# fmt: off
UNITS: Mapping[str, Unit] = {  # by name ending; the longest match counts
    "_m":             Unit("m",        (MM,)),
    "_mm":            Unit("mm",       (Wrong("metres", 1e3),)),
    "_m_s":           Unit("m/s",      (Wrong("millimetres a second", 1e-3),)),
    "_m_s2":          Unit("m/s²",     (Wrong("millimetres a second squared", 1e-3),)),
    "_s":             Unit("s",        (MS,)),
    "_min":           Unit("min",      (Wrong("seconds", 1.0 / 60.0), MS)),
    "_hz":            Unit("Hz",       (Wrong("kilohertz", 1e3), Wrong("millihertz", 1e-3))),
    "_deg":           Unit("degrees",  (Wrong("radians", 180.0 / pi), MILLIDEGREES)),
    "_deg_s":         Unit("degrees/s", (Wrong("radians a second", 180.0 / pi), MILLIDEGREES)),
    "_deg_s2":        Unit("degrees/s²", (Wrong("radians/s²", 180.0 / pi), MILLIDEGREES)),
    "_rad":           Unit("rad",      (Wrong("degrees", pi / 180.0), MILLIRADIANS)),
    "_rad_s":         Unit("rad/s",    (Wrong("degrees a second", pi / 180.0), MILLIRADIANS)),
    "_kg":            Unit("kg",       (GRAM,)),
    "_kg_m2":         Unit("kg m²",    (Wrong("grams times square metres", 1e-3),)),
    "_N":             Unit("N",        (Wrong("millinewtons", 1e-3),)),
    "_Nm":            Unit("N m",      (Wrong("newton millimetres", 1e-3),)),
    "_N_s":           Unit("N/s",      (Wrong("millinewtons a second", 1e-3),)),
    "_N_m":           Unit("N/m",      (Wrong("newtons per millimetre", 1e3), Wrong("mN/m", 1e-3))),
    "_Nm_rad":        Unit("N m/rad",  (Wrong("newton millimetres per radian", 1e-3),)),
    "_J":             Unit("J",        (Wrong("millijoules", 1e-3),)),
    "_per_mm":        Unit("per mm",   (Wrong("counts per metre", 1e-3),)),
    "_per_deg":       Unit("per degree", (Wrong("counts per thousand degrees", 1e-3),)),
    "_per_N":         Unit("per N",    (Wrong("counts per kilonewton", 1e-3),)),
    "_per_Nm":        Unit("per N m",  (Wrong("counts per kilonewton metre", 1e-3),)),
    "_per_mm_s":      Unit("per mm/s", (Wrong("counts per metre a second", 1e-3),)),
}
# fmt: on


def unit_of(name: str) -> Unit | None:
    """Return the unit at the end of a field's name, None when there is none."""
    endings = [ending for ending in UNITS if name.endswith(ending)]
    return UNITS[max(endings, key=len)] if endings else None


def question(name: str, value: float, limit: float) -> str:
    """Return a question about the unit that an out-of-range number suggests; empty if none.

    Args:
        name: Of the field, with its unit at the end.
        value: What was found.
        limit: The largest or smallest plausible number, whichever was exceeded.
    """
    unit = unit_of(name)
    if unit is None or value == 0.0:
        return ""
    size, edge = abs(value), abs(limit)
    is_large = size > edge
    for wrong in unit.wrongs:
        right = size * wrong.factor
        if (wrong.factor < 1.0) == is_large and (right <= edge if is_large else right >= edge):
            return f"; is that in {wrong.name}?"
    return ""


def beyond(kind: str, name: str, value: Any, limit: Any) -> str:
    """Return the text of a broken bound: value, bound, unit, and the unit error it suggests.

    Args:
        kind: pydantic's error type: greater_than, less_than_equal, ...
        name: Of the field.
        value: What was found.
        limit: The bound.
    """
    unit = unit_of(name)
    symbol = "" if unit is None else f" {unit.symbol}"
    bound = f"{limit:g}{symbol}" if isinstance(limit, int | float) else str(limit)
    rule = {
        "greater_than": f"must be above {bound}",
        "greater_than_equal": f"must be at least {bound}",
        "less_than": f"must be below {bound}",
        "less_than_equal": f"must be at most {bound}",
    }[kind]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{rule}, found {value!r}"
    asked = question(name, float(value), float(limit))
    return f"{rule}, found {value:g}{symbol}{asked}"


def mounting_objection(rotation_rad: tuple[float, float, float]) -> str:
    """Return why a fitted mounting rotation must not be used, empty when it is plausible."""
    turned_rad = hypot(*rotation_rad)
    if turned_rad <= MOUNTING_MOST_RAD:
        return ""
    asked = question("mounting_rotation_rad", turned_rad, MOUNTING_MOST_RAD).removeprefix("; ")
    return (
        f"mounting_rotation_rad turns the sensor by {turned_rad:.3g} rad "
        f"({round(degrees(turned_rad), 0):g} degrees), the limit is {MOUNTING_MOST_RAD:g} rad; "
        f"{asked}{' ' if asked else ''}otherwise correct sensor.T_flange_sensor in the cell file "
        "(`forcemesh check axes` shows how), then calibrate"
    )


def joints_in_radians(lowest: tuple[float, ...], highest: tuple[float, ...]) -> bool:
    """Return whether a joint range in degrees is so small that it must be in radians."""
    return max(abs(angle) for angle in (*lowest, *highest)) <= MOST_RADIANS
