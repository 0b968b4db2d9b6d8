"""Plausibility check of the sensor: not finite, saturated, frozen, jumped. Pure: state in and out.

Each fault has its code in forcemesh/faults.py. A rejected reading is never replaced by zero force:
a regulator that presses would press harder.
"""

from dataclasses import dataclass
from math import hypot, isfinite
from typing import NamedTuple

import numpy as np

from common.config.cell import CellConfig
from common.motion.frames import Array

SATURATED_FROM = 0.95  # of the range, on any axis: near its end a sensor is no longer linear
FEWEST_REPEATS = 3  # a slow sensor may repeat its last reading
WILD_APART = 10  # samples: a single outlier is a spike on the line, two this close are a fault
MARGIN_OF_RANGE = 0.02  # added to the largest step: noise and model error
LEVER_BEYOND_TCP_M = 0.1  # largest distance of a contact from the TCP
AXES = (("Fx", "N"), ("Fy", "N"), ("Fz", "N"), ("Mx", "N m"), ("My", "N m"), ("Mz", "N m"))


class WrenchFault(NamedTuple):
    """Fault: a code of forcemesh/faults.py and a text; both empty: no fault."""

    code: str
    text: str


NO_FAULT = WrenchFault("", "")


@dataclass(frozen=True, slots=True)
class ReadingLimits:
    """Limits of plausible readings for this sensor, tool and arm."""

    range: tuple[float, ...]  # N, N, N, N m, N m, N m
    step: tuple[float, float]  # of force [N] and torque [N m] from one sample to the next
    step_per_s: tuple[float, float]  # added for each second between them
    frozen_s: float  # limit for the same six numbers; 0: this sensor has no noise

    @classmethod
    def of(cls, cell: CellConfig) -> "ReadingLimits":
        """Return the limits of a cell.

        An impact at speed v on a contact of stiffness k raises the force by k v each second, and
        stops the mass m in front of the sensor within one sample at the soonest: m v / T.
        """
        v, contact, sensor = cell.limits.speed_m_s, cell.contact, cell.sensor
        sensor_hz = cell.rates.sensor_hz
        T_sensor_tcp = sensor.T_flange_sensor.pose.inverse() * cell.tool.T_flange_tcp.pose
        lever_m = float(np.linalg.norm(T_sensor_tcp.translation)) + LEVER_BEYOND_TCP_M
        range_N, range_Nm = sensor.force_range_N, sensor.torque_range_Nm
        impact_N, push_N_s = contact.inertia_kg * v * sensor_hz, contact.stiffness_N_m * v
        return cls(
            range=(range_N,) * 3 + (range_Nm,) * 3,
            step=(
                MARGIN_OF_RANGE * range_N + impact_N,
                MARGIN_OF_RANGE * range_Nm + impact_N * lever_m,
            ),
            step_per_s=(push_N_s, push_N_s * lever_m),
            frozen_s=sensor.frozen_s,
        )


class ReadingHistory(NamedTuple):
    """State of the check: the readings before this one."""

    raw: Array | None = None  # the last reading
    counts: bool = False  # whether it was accepted
    taken: Array | None = None  # the last accepted reading
    taken_s: float = 0.0  # its age
    still_s: float = 0.0  # time for which the reading has been identical
    repeats: int = 0  # number of repetitions
    tame: int = WILD_APART  # readings since the last outlier
    spikes: int = 0  # single outliers that were rejected


def check_reading(
    before: ReadingHistory, reading: Array, dt_s: float, bounds: ReadingLimits
) -> tuple[ReadingHistory, WrenchFault]:
    """Return the state after one more reading, and the fault of the sensor.

    A single outlier is rejected; the next reading decides whether it was a spike or a fault.

    Args:
        before: State of the check.
        reading: Force [N] and torque [N m], sensor axes. Shape (6,).
        dt_s: Time since the reading before.
        bounds: Limits of plausible readings.
    """
    values = reading.tolist()
    same = before.raw is not None and values == before.raw.tolist()
    after = before._replace(
        raw=reading,
        counts=False,
        still_s=before.still_s + dt_s if same else 0.0,
        repeats=before.repeats + 1 if same else 0,
        taken_s=before.taken_s + dt_s,
    )
    # A number that is not finite is not below its limit either.
    ranges = zip(values, bounds.range, strict=True)
    if not all(abs(value) < SATURATED_FROM * full for value, full in ranges):
        return after._replace(taken=None), _range_fault(values, bounds)
    if 0.0 < bounds.frozen_s <= after.still_s and after.repeats >= FEWEST_REPEATS:
        text = f"the sensor is frozen: the same six numbers for {after.still_s * 1e3:.0f} ms"
        return after._replace(taken=None), WrenchFault("sensor_frozen", text)
    change = (reading - (reading if after.taken is None else after.taken)).tolist()
    force_N, torque_Nm = hypot(*change[:3]), hypot(*change[3:])
    most_N, most_Nm = (
        step + per_s * after.taken_s
        for step, per_s in zip(bounds.step, bounds.step_per_s, strict=True)
    )
    if force_N <= most_N and torque_Nm <= most_Nm:
        tame = min(after.tame + 1, WILD_APART)
        return after._replace(counts=True, taken=reading, taken_s=0.0, tame=tame), NO_FAULT
    if after.tame >= WILD_APART:
        return after._replace(tame=0, spikes=after.spikes + 1), NO_FAULT
    size, most, unit = (force_N, most_N, "N") if force_N > most_N else (torque_Nm, most_Nm, "N m")
    text = f"the reading jumped by {size:.4g} {unit}, the limit for contact is {most:.4g} {unit}"
    return after._replace(taken=None, tame=0), WrenchFault("sensor_jump", text)


def _range_fault(values: list[float], bounds: ReadingLimits) -> WrenchFault:
    """Return the fault of the first axis that is not finite or beyond its range."""
    axis, unit, value, full = next(
        (axis, unit, value, full)
        for (axis, unit), value, full in zip(AXES, values, bounds.range, strict=True)
        if not abs(value) < SATURATED_FROM * full
    )
    if not isfinite(value):
        return WrenchFault("not_finite", f"{axis} of the sensor is not finite")
    text = f"{axis} reads {value:.4g} {unit}, {SATURATED_FROM:.0%} of its range"
    return WrenchFault("sensor_saturated", f"{text} of {full:g} {unit} or beyond")
