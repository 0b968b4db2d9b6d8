"""Plausible ranges of cell file values, and the unit error that a value outside them suggests.

Pure: only names, numbers and texts, so that it loads fast in every verb.
"""

from collections.abc import Mapping
from math import degrees, hypot, pi
from typing import Any, NamedTuple

MOUNTING_MOST_RAD = 0.2  # a fit corrects mounting tolerance, not a wrong orientation
COUNTS_MOST = 2**31 - 1  # an RDT reading is a signed number of 32 bits
LONGEST_SENSOR_LEVER_M = 1.0  # torque range over force range of a sensor: 8 to 160 mm on the market
MOST_RADIANS = 2.0 * pi + 1e-3  # in degrees, no joint range of an arm is this small
SLOWEST_DEG_S = 20.0  # no joint of an arm is this slow


class OtherUnit(NamedTuple):
    """Another common unit of the same quantity."""

    name: str
    factor: float  # conversion to the right unit


class Unit(NamedTuple):
    """The unit at the end of a field's name."""

    symbol: str
    wrongs: tuple[OtherUnit, ...]


MM, MS, GRAM = (
    OtherUnit("millimetres", 1e-3),
    OtherUnit("milliseconds", 1e-3),
    OtherUnit("grams", 1e-3),
)
MILLIDEGREES, MILLIRADIANS = (
    OtherUnit("thousandths of a degree", 1e-3),
    OtherUnit("milliradians", 1e-3),
)
# fmt: off
UNITS: Mapping[str, Unit] = {  # by name ending; the longest match counts
    "_m":             Unit("m",        (MM,)),
    "_mm":            Unit("mm",       (OtherUnit("metres", 1e3),)),
    "_m_s":           Unit("m/s",      (OtherUnit("millimetres a second", 1e-3),)),
    "_m_s2":          Unit("m/s²",     (OtherUnit("millimetres a second squared", 1e-3),)),
    "_s":             Unit("s",        (MS,)),
    "_min":           Unit("min",      (OtherUnit("seconds", 1.0 / 60.0), MS)),
    "_hz":            Unit("Hz",       (OtherUnit("kilohertz", 1e3), OtherUnit("millihertz", 1e-3))),
    "_deg":           Unit("degrees",  (OtherUnit("radians", 180.0 / pi), MILLIDEGREES)),
    "_deg_s":         Unit("degrees/s", (OtherUnit("radians a second", 180.0 / pi), MILLIDEGREES)),
    "_deg_s2":        Unit("degrees/s²", (OtherUnit("radians/s²", 180.0 / pi), MILLIDEGREES)),
    "_rad":           Unit("rad",      (OtherUnit("degrees", pi / 180.0), MILLIRADIANS)),
    "_rad_s":         Unit("rad/s",    (OtherUnit("degrees a second", pi / 180.0), MILLIRADIANS)),
    "_kg":            Unit("kg",       (GRAM,)),
    "_kg_m2":         Unit("kg m²",    (OtherUnit("grams times square metres", 1e-3),)),
    "_N":             Unit("N",        (OtherUnit("millinewtons", 1e-3),)),
    "_Nm":            Unit("N m",      (OtherUnit("newton millimetres", 1e-3),)),
    "_N_s":           Unit("N/s",      (OtherUnit("millinewtons a second", 1e-3),)),
    "_N_m":           Unit("N/m",      (OtherUnit("newtons per millimetre", 1e3), OtherUnit("mN/m", 1e-3))),
    "_Nm_rad":        Unit("N m/rad",  (OtherUnit("newton millimetres per radian", 1e-3),)),
    "_J":             Unit("J",        (OtherUnit("millijoules", 1e-3),)),
    "_per_mm":        Unit("per mm",   (OtherUnit("counts per metre", 1e-3),)),
    "_per_deg":       Unit("per degree", (OtherUnit("counts per thousand degrees", 1e-3),)),
    "_per_N":         Unit("per N",    (OtherUnit("counts per kilonewton", 1e-3),)),
    "_per_Nm":        Unit("per N m",  (OtherUnit("counts per kilonewton metre", 1e-3),)),
    "_per_mm_s":      Unit("per mm/s", (OtherUnit("counts per metre a second", 1e-3),)),
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
