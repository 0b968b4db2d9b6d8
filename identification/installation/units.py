"""Identification of a wrong unit by the ratio of measured to expected value. Pure."""

from typing import NamedTuple

import numpy as np

from common.motion.frames import Array

SAME_FACTOR = 1.12  # tolerance: the known payload is not exact
LONGEST_M = 2.0  # sensors and tools are closer to the flange
LEVER_MOST_M = 0.5  # a centre of mass is closer to the sensor
LEVER_USUAL_M = (0.005, 0.3)

FORCE_UNITS = {
    1.0 / 9.80665: "kilograms-force are taken for newtons",
    1.0 / 4.4482216: "pounds-force are taken for newtons",
    1e-3: "kilonewtons are taken for newtons",
    1e3: "millinewtons are taken for newtons",
    9.80665: "newtons are multiplied by 9.81 as if they were kilograms-force",
    4.4482216: "newtons are multiplied by 4.45 as if they were pounds-force",
}
TORQUE_UNITS = {
    1e3: "newton millimetres are taken for newton metres",
    1e2: "newton centimetres are taken for newton metres",
    8.8507458: "inch-pounds are taken for newton metres",
    10.197162: "kilogram-force centimetres are taken for newton metres",
    0.10197162: "kilogram-force metres are taken for newton metres",
    1e-3: "kilonewton metres, or metres for millimetres, are taken for newton metres",
}


class WrongUnit(NamedTuple):
    """Wrong unit: its description, and the factor to divide the readings by."""

    text: str
    factor: float


def unit_of(times: float, units: dict[float, str]) -> WrongUnit | None:
    """Return the wrong unit that explains a ratio of measured to expected value, if one does."""
    if times <= 0.0:
        return None
    factor = min(units, key=lambda u: abs(np.log(times / u)))
    if abs(np.log(times / factor)) > np.log(SAME_FACTOR):
        return None
    return WrongUnit(units[factor], factor)


def units_of_lever(lever_m: float) -> list[WrongUnit]:
    """Return the wrong units of torque that would explain an implausible lever."""
    least_m, most_m = LEVER_USUAL_M
    return [
        WrongUnit(text, f) for f, text in TORQUE_UNITS.items() if least_m <= lever_m / f <= most_m
    ]


def in_millimetres(length_m: Array) -> bool:
    """Return whether a vector of the cell file must be in millimetres."""
    return bool(np.linalg.norm(length_m) > LONGEST_M)
