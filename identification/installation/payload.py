"""Comparison of measured weight and lever with those of the cell file, and wrong units. Pure."""

from math import hypot

import numpy as np

from common.motion.frames import GRAVITY_M_S2, Array
from identification.installation.terms import (
    ExpectedInstallation,
    InstallationFinding,
    in_millimetres,
)

MASS_SHARE = 0.1  # a sensor's gain may be off by 3 %, a cable may hang on the tool
COM_M = 0.01
SURE_TIMES = 2.0  # times the residual
LEVER_KNOWN_M = 0.01
SAME_FACTOR = 1.12  # tolerance: the known payload is not exact
LEVER_MOST_M = 0.5  # a centre of mass is closer to the sensor
LEVER_USUAL_M = (0.005, 0.3)

# Wrong units, by the factor to divide the readings by.
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


def unit_factor(times: float, units: dict[float, str]) -> float | None:
    """Return the factor of the wrong unit that explains a ratio of measured to expected value."""
    if times <= 0.0:
        return None
    factor = min(units, key=lambda u: abs(np.log(times / u)))
    return factor if abs(np.log(times / factor)) <= np.log(SAME_FACTOR) else None


def length_findings(expected: ExpectedInstallation) -> list[InstallationFinding]:
    """Return every length of the cell file that must be in millimetres."""
    found = []
    for key, value in expected.lengths_m.items():
        if value is not None and in_millimetres(value):
            text = f"{key} is {np.linalg.norm(value):.4g} m long: it is in millimetres"
            remedy = f"write {key}: {_vector(value / 1e3)}"
            found.append(InstallationFinding("length", text, remedy))
    return found


def mass_finding(
    mass_kg: float, rms_N: float, expected: ExpectedInstallation
) -> InstallationFinding | None:
    """Return the finding for a measured mass that certainly differs from the expected one.

    Args:
        mass_kg: Measured mass, if the readings are in newtons.
        rms_N: Residual of the fit.
        expected: Expected installation; its mass may be unknown.
    """
    known = expected.mass_kg
    if known is None or abs(mass_kg / known - 1.0) <= MASS_SHARE:
        return None
    if abs(mass_kg - known) * GRAVITY_M_S2 <= SURE_TIMES * rms_N:
        return None
    factor = unit_factor(mass_kg / known, FORCE_UNITS)
    weight_N, known_N = mass_kg * GRAVITY_M_S2, known * GRAVITY_M_S2
    if factor is not None:
        text = f"the tool of {known_N:.4g} N reads {weight_N:.3g}: {FORCE_UNITS[factor]}"
        remedy = (
            f"divide the forces by {factor:.4g}, or, if this is another tool, write its "
            "payload.mass_kg"
        )
        return InstallationFinding("force_unit", text, remedy)
    text = (
        f"the tool weighs {mass_kg:.3g} kg, but the cell file says {known:.3g} kg "
        f"({100 * (known / mass_kg - 1.0):+.0f} %)"
    )
    remedy = f"write payload.mass_kg: {mass_kg:.3f}, or run `forcemesh calibrate`"
    return InstallationFinding("mass", text, remedy, "payload")


def lever_finding(
    com_m: Array, uncertainty_m: float, expected: ExpectedInstallation
) -> InstallationFinding | None:
    """Return the finding for a measured centre of mass that is implausible or not the expected one.

    Args:
        com_m: Measured centre of mass, if force and torque are in N and N m.
        uncertainty_m: Lever of the weight that would explain the residual of the torques.
        expected: Expected installation; its centre of mass may be unknown.
    """
    lever_m, known = hypot(*com_m), expected.com_m
    known_m = 0.0 if known is None else hypot(*known)
    if known_m >= LEVER_KNOWN_M:
        factor = unit_factor(lever_m / known_m, TORQUE_UNITS)
        if factor is not None:
            text = (
                f"the moments put the centre of mass {lever_m:.3g} m from the sensor, but it is "
                f"{known_m:.3g} m away: {TORQUE_UNITS[factor]}"
            )
            return InstallationFinding("torque_unit", text, f"divide the torques by {factor:.4g}")
    if lever_m > LEVER_MOST_M:
        least_m, most_m = LEVER_USUAL_M
        factors = [f for f in TORQUE_UNITS if least_m <= lever_m / f <= most_m]
        units = ", or ".join(TORQUE_UNITS[f] for f in factors) or "the unit of the torques is wrong"
        text = f"the centre of mass would be {lever_m:.3g} m from the sensor: {units}"
        divisor = " or ".join(f"{f:.4g}" for f in factors) or "what its manual says"
        return InstallationFinding("torque_unit", text, f"divide the torques by {divisor}")
    if known is None or hypot(*com_m - known) <= max(COM_M, SURE_TIMES * uncertainty_m):
        return None
    text = (
        f"the centre of mass is at {_millimetres(com_m)} mm, but the cell file says "
        f"{_millimetres(known)} mm, {1e3 * np.linalg.norm(com_m - known):.0f} mm away"
    )
    remedy = f"write payload.com_m: {_vector(com_m)}, or run `forcemesh calibrate`"
    return InstallationFinding("com", text, remedy, "payload")


def _vector(v: Array) -> str:
    return f"[{', '.join(f'{x + 0.0:.4g}' for x in v.round(4))}]"


def _millimetres(v: Array) -> str:
    return f"({', '.join(f'{x + 0.0:.0f}' for x in (1e3 * v).round())})"
