"""Rest detector for the arm and the sensor readings, over a sliding window. Pure."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from common.motion.frames import Array
from identification.static_poses import angle

STILLNESS_WINDOW_S = 0.4
WINDOW_NS = round(1e9 * STILLNESS_WINDOW_S)
LEAST_STILL_SAMPLES = 16
STILL_M, STILL_RAD = 1e-4, np.radians(0.05)
# Allowed difference of the means of both window halves: absolute, or in standard deviations.
STEADY_N, STEADY_NM = 0.05, 0.003
DEVIATIONS = 5.0


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One sensor reading in sensor axes, with the sensor's pose in base axes."""

    at_ns: int
    position_m: Array  # of the sensor in base
    R_base_sensor: Array
    reading: Array  # force [N] and torque [N m]. Shape (6,).


class StillnessDetector:
    """Sliding window of samples; reports what is not at rest in it."""

    def __init__(self) -> None:
        """Create an empty window."""
        self._samples: deque[PoseSample] = deque()

    def add(self, sample: PoseSample) -> None:
        """Add a newer sample."""
        self._samples.append(sample)
        while len(self._samples) > 2 and sample.at_ns - self._samples[1].at_ns >= WINDOW_NS:
            self._samples.popleft()

    @property
    def newest(self) -> PoseSample | None:
        """The last sample, None after a gap."""
        return self._samples[-1] if self._samples else None

    def clear(self) -> None:
        """Clear the window: after a gap, a fault or a motion."""
        self._samples.clear()

    def pending_condition(self) -> str:
        """Return the condition that is waited for; empty when everything is at rest."""
        samples = self._samples
        if len(samples) < LEAST_STILL_SAMPLES or samples[-1].at_ns - samples[0].at_ns < WINDOW_NS:
            return "readings"
        places = np.array([sample.position_m for sample in samples])
        moved_m = float(np.linalg.norm(places - places[-1], axis=1).max())
        R = np.array([sample.R_base_sensor for sample in samples])
        turned_rad = float(angle(R[-1], R).max())
        if moved_m > STILL_M or turned_rad > STILL_RAD:
            return f"the arm to rest ({1e3 * moved_m:.2f} mm, {np.degrees(turned_rad):.2f} degrees)"
        readings = np.array([sample.reading for sample in samples])
        first, second = np.array_split(readings, 2)
        change = np.abs(second.mean(axis=0) - first.mean(axis=0))
        spread = np.sqrt(first.var(axis=0) / len(first) + second.var(axis=0) / len(second))
        allowed = np.maximum([STEADY_N] * 3 + [STEADY_NM] * 3, DEVIATIONS * spread)
        if (change <= allowed).all():
            return ""
        if (change[:3] > allowed[:3]).any():
            return f"a steady force (it changed by {change[:3].max():.2f} N)"
        return f"a steady torque (it changed by {change[3:].max():.3f} N m)"
