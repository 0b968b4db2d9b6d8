"""Settings page of ATI sensors, `netftapi2.xml`: counts, units and range. Pure.

Counts are per unit, and the unit is selected on the sensor's web page. N with N-mm is common;
without the conversion the torque is a thousand times too large.
Source: ATI 9610-05-Ethernet Axia chapter 11, unit codes in section 10.5.
"""

import math
import re
from typing import NamedTuple

from common.config.cell_sensor import SensorSection
from forcemesh.errors import DataError
from services.sensor.driver import NO_FAULT, Info, SensorFault

PATH = "/netftapi2.xml"
SAME_COUNTS = 1e-3  # relative tolerance of two scales: more is not rounding
RATINGS = re.compile(r"[;,\s]+")  # between one axis and the next
ELEMENT = re.compile(r"<([A-Za-z0-9_]+)>([^<]*)</\1>")

LBF_N, INCH_M, KGF_N = 4.4482216152605, 0.0254, 9.80665
FORCE_UNITS = {
    "lbf": LBF_N, "lb": LBF_N, "n": 1.0, "klbf": 1e3 * LBF_N, "klb": 1e3 * LBF_N, "kn": 1e3,
    "kgf": KGF_N, "kg": KGF_N, "gf": 1e-3 * KGF_N, "g": 1e-3 * KGF_N,
}  # fmt: skip
TORQUE_UNITS = {
    "lbfin": LBF_N * INCH_M, "lbin": LBF_N * INCH_M, "lbfft": 12 * LBF_N * INCH_M,
    "lbft": 12 * LBF_N * INCH_M, "nm": 1.0, "nmm": 1e-3, "kgfcm": 0.01 * KGF_N,
    "kgcm": 0.01 * KGF_N, "knm": 1e3,
}  # fmt: skip
FORCE_CODES = {1: "lbf", 2: "N", 3: "klbf", 4: "kN", 5: "kgf", 6: "gf"}
TORQUE_CODES = {1: "lbf-in", 2: "lbf-ft", 3: "Nm", 4: "N-mm", 5: "kgf-cm", 6: "kN-m"}


class SettingsPage(NamedTuple):
    """Settings of the sensor, in SI units."""

    counts_per_N: float
    counts_per_Nm: float
    force_unit: str  # as on the page
    torque_unit: str
    model: str = ""
    serial: str = ""
    force_range_N: float | None = None  # of its strongest axis
    torque_range_Nm: float | None = None


def parse(text: str) -> SettingsPage:
    """Parse a page.

    Raises:
        DataError: It is not a settings page, or a value in it is invalid; names the value.
    """
    found = {name.lower(): value.strip() for name, value in ELEMENT.findall(text)}
    force_unit, in_N = _unit(found, "fu", FORCE_UNITS, FORCE_CODES)
    torque_unit, in_Nm = _unit(found, "tu", TORQUE_UNITS, TORQUE_CODES)
    ratings = [_number(part) for part in RATINGS.split(found.get("cfgmr", ""))]
    is_whole = len(ratings) == 6 and all(0.0 < rating < math.inf for rating in ratings)
    return SettingsPage(
        counts_per_N=_counts(found, "cfgcpf") / in_N,
        counts_per_Nm=_counts(found, "cfgcpt") / in_Nm,
        force_unit=force_unit,
        torque_unit=torque_unit,
        model=found.get("prodname", ""),
        serial=found.get("cfgcalsn", "") or found.get("setserial", ""),
        force_range_N=max(ratings[:3]) * in_N if is_whole else None,
        torque_range_Nm=max(ratings[3:]) * in_Nm if is_whole else None,
    )


def scale_of(sensor: SensorSection, page: SettingsPage | None = None) -> SensorSection:
    """Return the settings of the sensor, with the page's counts if there is one."""
    if page is None:
        return sensor
    counts = {"counts_per_N": page.counts_per_N, "counts_per_Nm": page.counts_per_Nm}
    return sensor.model_copy(update=counts)


def disagreement(sensor: SensorSection, page: SettingsPage) -> SensorFault:
    """Return the fault of a value in which cell file and sensor's page differ."""
    pairs = (
        ("counts_per_N", sensor.counts_per_N, page.counts_per_N, page.force_unit),
        ("counts_per_Nm", sensor.counts_per_Nm, page.counts_per_Nm, page.torque_unit),
    )
    for name, ours, theirs, unit in pairs:
        if sensor.calibration == "both" and abs(ours / theirs - 1.0) > SAME_COUNTS:
            text = (
                f"sensor.{name} is {ours:.9g} in the cell file and {theirs:.9g} on the sensor's "
                f"page (its unit is {unit}): {ours / theirs:.4g} times as much"
            )
            return SensorFault("sensor_calibration", text)
    ranges = (
        ("force_range_N", sensor.force_range_N, page.force_range_N),
        ("torque_range_Nm", sensor.torque_range_Nm, page.torque_range_Nm),
    )
    for name, expected, rated in ranges:
        if rated is not None and expected > rated * (1.0 + SAME_COUNTS):
            text = f"sensor.{name} is {expected:g} in the cell file, {rated:g} on the sensor's page"
            return SensorFault("sensor_calibration", f"{text} for its strongest axis")
    return NO_FAULT


def info_of(sensor: SensorSection, page: SettingsPage | None) -> Info:
    """Return the identity of an RDT sensor."""
    scale = scale_of(sensor, page if sensor.calibration == "page" else None)
    counts = f"{scale.counts_per_N:.9g} counts per N, {scale.counts_per_Nm:.9g} per N m"
    units = "" if page is None else f" (its units: {page.force_unit}, {page.torque_unit})"
    sources = {"cell": "the cell file", "page": "the sensor's page", "both": "cell file and page"}
    return Info(
        model=(page.model if page is not None else "") or "RDT sensor",
        serial=page.serial if page is not None else "",
        calibration=f"{counts} from {sources[sensor.calibration]}{units}",
        force_range_N=sensor.force_range_N,
        torque_range_Nm=sensor.torque_range_Nm,
    )


def _number(text: str) -> float:
    """Return the number that a text holds, 0 if it holds none."""
    try:
        return float(text)
    except ValueError:
        return 0.0


def _counts(found: dict[str, str], name: str) -> float:
    counts = _number(found.get(name, ""))
    if not 0.0 < counts < 1e15:
        raise DataError(f"no count of {name} in the sensor's page: {found.get(name, 'missing')!r}")
    return counts


def _unit(
    found: dict[str, str], which: str, units: dict[str, float], codes: dict[int, str]
) -> tuple[str, float]:
    """Return a unit and its factor to SI; the page's text has priority over its code."""
    word = found.get(f"scfg{which}", "")
    number = found.get(f"cfg{which}", "")
    name = word or codes.get(int(number) if number.isascii() and number.isdigit() else 0, "")
    factor = units.get(re.sub(r"[^a-z]", "", name.lower()))
    if factor is None:
        text = word or number or "missing"
        raise DataError(f"the sensor's page has an unknown unit: cfg{which} is {text!r}")
    return name, factor
