"""Plausibility check of the sensor: not finite, saturated, frozen, jumped. Pure.

Each fault has its code in forcemesh/faults.py. A rejected reading is never replaced by zero force:
a regulator that presses would press harder.
"""

from dataclasses import dataclass
from math import dist, isfinite

import numpy as np

from common.config.cell import CellConfig
from common.config.cell_sensor import SATURATED_FROM
from forcemesh.faults import tripped
from forcemesh.messages import Trip

FEWEST_REPEATS = 3  # a slow sensor may repeat its last reading
WILD_APART = 10  # samples: a single outlier is a spike on the line, two this close are a fault
MARGIN_OF_RANGE = 0.02  # added to the largest step: noise and model error
LEVER_BEYOND_TCP_M = 0.1  # largest distance of a contact from the TCP
CHANNELS = (("Fx", "N"), ("Fy", "N"), ("Fz", "N"), ("Mx", "N m"), ("My", "N m"), ("Mz", "N m"))


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
        v, plant, sensor = cell.limits.speed_m_s, cell.plant, cell.sensor
        T_sensor_tcp = sensor.T_flange_sensor.pose.inverse() * cell.tool.T_flange_tcp.pose
        lever_m = float(np.linalg.norm(T_sensor_tcp.translation)) + LEVER_BEYOND_TCP_M
        range_N, range_Nm = sensor.force_range_N, sensor.torque_range_Nm
        impact_N, push_N_s = plant.inertia_kg * v * plant.sensor_hz, plant.stiffness_N_m * v
        return cls(
            range=(range_N,) * 3 + (range_Nm,) * 3,
            step=(
                MARGIN_OF_RANGE * range_N + impact_N,
                MARGIN_OF_RANGE * range_Nm + impact_N * lever_m,
            ),
            step_per_s=(push_N_s, push_N_s * lever_m),
            frozen_s=sensor.frozen_s,
        )


class ReadingCheck:
    """Check of each reading against the ones before it.

    A single outlier is rejected; the next reading decides whether it was a spike or a fault.
    """

    def __init__(self, bounds: ReadingLimits) -> None:
        """Begin without readings."""
        self._bounds = bounds
        self.spikes = 0  # single outliers that were rejected
        self.clear()

    def clear(self) -> None:
        """Forget the readings, not the number of spikes."""
        self.accepted = False  # whether the last reading is used
        self._last: tuple[float, ...] | None = None  # reading
        self._repeats, self._still_s = 0, 0.0  # how often and how long it has been identical
        self._reference: tuple[float, ...] | None = None  # the last accepted reading
        self._reference_s = 0.0  # its age
        self._calm = WILD_APART  # readings since the last outlier

    def fault_of(self, reading: tuple[float, ...], dt_s: float) -> Trip | None:
        """Return the fault of the sensor after one more reading.

        Args:
            reading: Force [N] and torque [N m], sensor axes; six numbers.
            dt_s: Time since the reading before.
        """
        bounds, same = self._bounds, reading == self._last
        self._repeats = self._repeats + 1 if same else 0
        self._still_s = self._still_s + dt_s if same else 0.0
        self._reference_s += dt_s
        self._last, self.accepted = reading, False
        for (axis, unit), value, full in zip(CHANNELS, reading, bounds.range, strict=True):
            if not abs(value) < SATURATED_FROM * full:  # nor is a number that is not finite
                self._reference = None
                if not isfinite(value):
                    return tripped("not_finite", f"{axis} of the sensor is not finite")
                text = (
                    f"{axis} reads {value:.4g} {unit}, {SATURATED_FROM:.0%} of its range of "
                    f"{full:g} {unit} or beyond"
                )
                return tripped("sensor_saturated", text, value=value, limit=full, unit=unit)
        if 0.0 < bounds.frozen_s <= self._still_s and self._repeats >= FEWEST_REPEATS:
            self._reference = None
            text = f"the sensor is frozen: the same six numbers for {self._still_s * 1e3:.0f} ms"
            return tripped("sensor_frozen", text)
        before = reading if self._reference is None else self._reference
        force_N, torque_Nm = dist(reading[:3], before[:3]), dist(reading[3:], before[3:])
        most_N, most_Nm = [
            step + per_s * self._reference_s
            for step, per_s in zip(bounds.step, bounds.step_per_s, strict=True)
        ]
        if force_N > most_N:
            return self._outlier_fault(force_N, most_N, "N")
        if torque_Nm > most_Nm:
            return self._outlier_fault(torque_Nm, most_Nm, "N m")
        self._calm = min(self._calm + 1, WILD_APART)
        self.accepted, self._reference, self._reference_s = True, reading, 0.0
        return None

    def _outlier_fault(self, change: float, most: float, unit: str) -> Trip | None:
        """Count a single outlier as a spike; the next one soon after it is a fault."""
        calm, self._calm = self._calm, 0
        if calm >= WILD_APART:
            self.spikes += 1
            return None
        self._reference = None
        text = (
            f"the reading jumped by {change:.4g} {unit}, the limit for contact is {most:.4g} {unit}"
        )
        return tripped("sensor_jump", text, value=change, limit=most, unit=unit)
