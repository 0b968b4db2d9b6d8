"""How what the tool presses on moves along the press axis: place, speed, acceleration. Pure.

An alpha-beta observer with both poles at 1/T sees a place. While a motion gets faster its speed is
2 T late; the acceleration, the change of that speed through a low-pass, makes up for it.
"""

from dataclasses import dataclass
from math import exp


@dataclass(frozen=True, slots=True)
class Drift:
    """Where the surface is and how it moves; None before the first look."""

    place_m: float | None = None
    speed_m_s: float = 0.0
    accel_m_s2: float = 0.0
    late_s: float = 0.0  # by which the speed is late

    def ahead_m(self, time_s: float, share: float) -> float:
        """Return how far the surface goes from now in a time [s]; `share` of its acceleration."""
        gained_m_s = share * self.accel_m_s2 * (self.late_s + 0.5 * time_s)
        return (self.speed_m_s + gained_m_s) * time_s

    def speed_in_m_s(self, time_s: float, share: float) -> float:
        """Return the speed that it will have in a time [s]; `share` of its acceleration."""
        return self.speed_m_s + share * self.accel_m_s2 * (self.late_s + time_s)


def look(drift: Drift, seen_m: float, dt_s: float, time_s: float) -> Drift:
    """Return how the surface moves after it was seen at `seen_m`; T is `time_s`."""
    if drift.place_m is None:
        return Drift(seen_m, late_s=2.0 * time_s)
    pole = exp(-dt_s / time_s)
    expected_m = drift.place_m + drift.speed_m_s * dt_s
    missed_m = seen_m - expected_m
    gained_m_s = (1.0 - pole) ** 2 / dt_s * missed_m
    accel_m_s2 = pole * drift.accel_m_s2 + (1.0 - pole) * gained_m_s / dt_s
    place_m = expected_m + (1.0 - pole * pole) * missed_m
    return Drift(place_m, drift.speed_m_s + gained_m_s, accel_m_s2, drift.late_s)
