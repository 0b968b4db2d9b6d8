"""Surface motion observer along the press axis: position, speed, acceleration. Pure.

A critically damped alpha-beta filter with p = exp(-dt / T), alpha = 1 - p^2, beta = (1 - p)^2.
Its speed lags by 2 T while the surface accelerates; the low-passed derivative of that speed
compensates for the lag.
"""

from dataclasses import dataclass
from math import exp


@dataclass(frozen=True, slots=True)
class SurfaceMotion:
    """Position and motion of the surface; position None before the first sample."""

    position_m: float | None = None
    speed_m_s: float = 0.0
    accel_m_s2: float = 0.0
    lag_s: float = 0.0  # lag of the speed estimate

    def ahead_m(self, time_s: float, share: float) -> float:
        """Return the surface's travel in a time [s], with a share of its acceleration [m]."""
        gained_m_s = share * self.accel_m_s2 * (self.lag_s + 0.5 * time_s)
        return (self.speed_m_s + gained_m_s) * time_s

    def speed_in_m_s(self, time_s: float, share: float) -> float:
        """Return the surface's speed after a time [s], with a share of its acceleration [m/s]."""
        return self.speed_m_s + share * self.accel_m_s2 * (self.lag_s + time_s)


def update(before: SurfaceMotion, measured_m: float, dt_s: float, time_s: float) -> SurfaceMotion:
    """Return the estimate updated by a measured position `measured_m`; T is `time_s`."""
    if before.position_m is None:
        return SurfaceMotion(measured_m, lag_s=2.0 * time_s)
    pole = exp(-dt_s / time_s)
    expected_m = before.position_m + before.speed_m_s * dt_s
    error_m = measured_m - expected_m
    gained_m_s = (1.0 - pole) ** 2 / dt_s * error_m
    accel_m_s2 = pole * before.accel_m_s2 + (1.0 - pole) * gained_m_s / dt_s
    position_m = expected_m + (1.0 - pole * pole) * error_m
    return SurfaceMotion(position_m, before.speed_m_s + gained_m_s, accel_m_s2, before.lag_s)
