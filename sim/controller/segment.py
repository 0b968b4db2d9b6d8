"""Segment: one motion with a trapezoidal speed profile along a path, stepped per tick.

The path parameter s follows ds/dt = rate. The rate rises with `accel`, is capped by program speed
times monitor speed, and falls to zero at the end of the path (the discrete ramp of
sim.robot.motion). HOLD caps the rate at zero; BRAKE does too and ends the segment.
"""

import math
from dataclasses import dataclass

import numpy as np

from common.motion.frames import Array
from common.motion.paths import MotionPath
from sim.as_language.errors import AsError

_SHRINKS = 8
_SHORTEST = 1e-9


@dataclass(frozen=True, slots=True)
class Ramp:
    """Rates of a segment per unit of its extent: cap [1/s], accel, decel, brake [1/s^2]."""

    cap: float
    accel: float
    decel: float
    brake: float


class Segment:
    """Motion between two points. `q` is the current joint position of this segment."""

    def __init__(self, path: MotionPath, ramp: Ramp, *, q_from: Array, q_to: Array) -> None:
        """Start at the beginning of the path with rate zero. Shapes (6,)."""
        self.path, self.ramp = path, ramp
        self.q_from, self.q_to = q_from, q_to
        self.q: Array = q_from
        self.share, self.rate = 0.0, 0.0
        self.slowing = False  # deceleration at the end of the path has begun
        self.braking = False
        self.done = bool(np.abs(q_to - q_from).max() < _SHORTEST)
        if self.done:
            self.share = 1.0

    @property
    def covered(self) -> Array:
        """Joint displacement so far [rad]. Shape (6,)."""
        return self.q - self.q_from

    def tick(self, dt_s: float, feed: float) -> None:
        """Advance; `feed` is the monitor speed as a fraction, zero while held.

        Raises AsError E6016 if the path cannot be continued: singular pose.
        """
        self.rate = self._next_rate(dt_s, 0.0 if self.braking else feed)
        if self.rate <= 0.0:
            self.done = self.done or self.braking
            return
        share, q = self._allowed_step(dt_s)
        self.rate = (share - self.share) / dt_s
        self.share, self.q = share, q
        if share >= 1.0:
            self.q, self.done = self.q_to, True

    def _next_rate(self, dt_s: float, feed: float) -> float:
        ramp = self.ramp
        half = 0.5 * ramp.decel * dt_s
        stopping = max(math.sqrt(half * half + 2.0 * ramp.decel * (1.0 - self.share)) - half, half)
        faster = self.rate + ramp.accel * dt_s
        capped = max(ramp.cap * feed, self.rate - ramp.brake * dt_s)
        self.slowing = stopping <= min(faster, capped)
        return max(0.0, min(faster, capped, stopping))

    def _allowed_step(self, dt_s: float) -> tuple[float, Array]:
        """Return share and joints after this tick, shortened to the joints' speed limits."""
        step, reason = self.rate * dt_s, ""
        for _ in range(_SHRINKS):
            share = min(1.0, self.share + step)
            if share > 1.0 - 1e-9:
                share = 1.0
            result = self.path.at(share, self.q)
            if result.q is None:
                reason, step = result.reason, 0.25 * step
                continue
            fastest = self.path.kinematics.max_speed_rad_s
            excess = float((np.abs(result.q - self.q) / fastest).max()) / dt_s
            if excess <= 1.0 + 1e-9:
                return share, result.q
            reason = "joint speed limit exceeded"
            step /= 1.05 * excess
        self.rate, self.braking, self.done = 0.0, True, True
        percent = 100 * self.share
        raise AsError("E6016", f"after {percent:.0f} % of the path: {reason}")
