"""The simulated force/torque sensor: bias, noise, quantisation and range. Deterministic by seed.

Sign of a real sensor: what it reads is the load on it, f_env + m (g - a), in its own axes about
its own origin. A hanging tool pulls along gravity; an environment that pushes the robot pushes
the reading the same way. (MuJoCo's force and torque sensors have the opposite sign.)
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import ge
from typing import Literal

import numpy as np

from common.motion.frames import Array
from sim.robot.settings import SensorSettings

_DRAWN_AT_ONCE = 100  # samples of noise: one at a time costs seven times as much

FtStatus = Literal["ok", "saturated", "fault"]


@dataclass(frozen=True, slots=True)
class FtSample:
    """One reading: the load on the sensor, sensor axes, about the sensor's origin."""

    force_N: Array
    torque_Nm: Array
    status: FtStatus
    counter: int  # of samples taken, from 1


class FtSensor:
    """Turns the true load into what the sensor would report. Call it at the sensor's rate.

    In good order unless somebody sets `wiring` (what each channel really shows of the load, six by
    six) or `disturb` (what becomes of a sample on its way; None: it never arrives).
    """

    def __init__(self, settings: SensorSettings, *, seed: int) -> None:
        """Start the noise at its seed."""
        self._counter = 0
        self.wiring = np.eye(6)
        self.disturb: Callable[[FtSample], FtSample | None] = lambda sample: sample
        s = settings
        noise = np.array([s.force_noise_N] * 3 + [s.torque_noise_Nm] * 3)
        self._noise = _normal(noise, np.random.default_rng(seed))
        self._bias = np.array([*s.force_bias_N, *s.torque_bias_Nm])
        self._range = np.array([s.force_range_N] * 3 + [s.torque_range_Nm] * 3)
        self._ranges = self._range.tolist()
        step = np.array([s.force_step_N] * 3 + [s.torque_step_Nm] * 3)
        self._rough = np.flatnonzero(step > 0.0)
        self._step = step[self._rough]

    def sample(self, *, force_N: Array, torque_Nm: Array) -> FtSample:
        """Return a reading of a true load [N, Nm], sensor axes and origin. Shapes (3,), (3,)."""
        self._counter += 1
        value = self.wiring.dot(np.concatenate((force_N, torque_Nm))) + self._bias
        value += next(self._noise)
        saturated = any(map(ge, map(abs, value.tolist()), self._ranges))
        if saturated:
            np.clip(value, -self._range, self._range, out=value)
        if self._rough.size:
            value[self._rough] = np.rint(value[self._rough] / self._step) * self._step
        return FtSample(
            force_N=value[:3],
            torque_Nm=value[3:],
            status="saturated" if saturated else "ok",
            counter=self._counter,
        )


def _normal(size: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Yield normal noise of a size in each channel, for ever. Shape (6,)."""
    while True:
        yield from size * rng.standard_normal((_DRAWN_AT_ONCE, len(size)))
