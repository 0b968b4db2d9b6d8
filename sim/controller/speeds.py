"""Ranges and units of SPEED, ACCURACY and similar: E0106 outside them."""

from collections.abc import Sequence

from sim.as_language.errors import AsError
from sim.as_language.values import single
from sim.controller.motion_requests import ProgramSpeed

LEAST_PERCENT, MOST_PERCENT = 0.01, 100.0
SECONDS = (0.1, 3601.0)
# To metres per second.
UNITS_M_S = {
    "MM/S": 1e-3, "MM/MIN": 1e-3 / 60.0, "CM/S": 1e-2, "CM/MIN": 1e-2 / 60.0,
    "M/S": 1.0, "M/MIN": 1.0 / 60.0,
}  # fmt: skip


def checked(value: float, least: float, most: float, name: str) -> float:
    """Return a value if it is within its range. Raises AsError E0106.

    The range tolerates single-precision rounding: a program's 0.01 is slightly less than 0.01.
    """
    if not least <= value <= most and not single(least) <= value <= single(most):
        raise AsError("E0106", f"{name} is {value:g}, must be within {least:g} .. {most:g}")
    return value


def percent(value: float, name: str) -> float:
    """Return a percentage. Raises AsError E0106."""
    return checked(value, LEAST_PERCENT, MOST_PERCENT, name)


def speed_of(value: float, modifiers: Sequence[str]) -> ProgramSpeed:
    """Return the speed of a value with its unit; without a unit it is a percentage.

    Raises AsError E0106 outside its range, E0111 for a unit that is not emulated.
    """
    unit = next((word for word in modifiers if word in UNITS_M_S), "")
    if unit:
        speed_m_s = value * UNITS_M_S[unit]
        return ProgramSpeed(checked(speed_m_s, 1e-5, 20.0, "SPEED in m/s"), "M/S")
    if "S" in modifiers:
        return ProgramSpeed(checked(value, *SECONDS, "SPEED in seconds"), "S")
    if "DEG/S" in modifiers or "DEG/MIN" in modifiers:
        raise AsError("E0111", "a rotational SPEED is an option of the controller")
    return ProgramSpeed(percent(value, "SPEED"))
