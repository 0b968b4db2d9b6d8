"""Simulated force/torque sensor: bias, noise, quantisation and range. Deterministic by seed.

Sign of a real sensor: the reading is the load on the sensor, f_env + m (g - a), in sensor axes
about the sensor origin. A hanging tool reads along gravity; an environment that pushes the robot
reads in the direction of the push. (MuJoCo's force and torque sensors have the opposite sign.)
"""

from collections.abc import Callable
from dataclasses import dataclass
from operator import ge
from typing import Literal

import numpy as np

from common.motion.frames import Array
from sim.robot.settings import SimSettings

_DRAWN_AT_ONCE = 100  # noise samples per draw: single draws cost seven times as much
_NO_QUANTUM = 2.0**-60  # [N, N m]; a power of two, far below the last digit of a reading

FtStatus = Literal["ok", "saturated", "fault"]


@dataclass(frozen=True, slots=True)
class FtSample:
    """One sample: load on the sensor, sensor axes, about the sensor origin."""

    force_N: Array
    torque_Nm: Array
    status: FtStatus
    counter: int  # number of the sample, from 1


class FtSensor:
    """Sensor model: converts the true load into a reported sample. Call it at the sensor rate.

    Fault injection: `wiring` (6 x 6 matrix from load to channels) and `disturb` (modifies a sample
    in transit; None: the sample is lost).
    """

    def __init__(self, settings: SimSettings, on_tool: Array, *, seed: int) -> None:
        """Seed the noise generator.

        Args:
            settings: Bias, noise, quantisation and range.
            on_tool: View of MuJoCo's sensors: load of the robot on the tool [N, N m]. Shape (6,).
            seed: Of the noise.
        """
        self._counter, self._on_tool = 0, on_tool
        self.wiring = np.eye(6)
        self.disturb: Callable[[FtSample], FtSample | None] = lambda sample: sample
        s = settings
        self._rng = np.random.default_rng(seed)
        self._noise = np.repeat([s.noise_force_N, s.noise_torque_Nm], 3)
        self._bias = np.array([*s.bias_force_N, *s.bias_torque_Nm])
        self._added = np.zeros((_DRAWN_AT_ONCE, 6))  # bias and noise of the present samples
        self._range = np.repeat([s.force_range_N, s.torque_range_Nm], 3)
        self._ranges = self._range.tolist()
        step = np.repeat([s.quantum_force_N, s.quantum_torque_Nm], 3)
        self._step = np.where(step > 0.0, step, _NO_QUANTUM)

    def sample(self) -> FtSample:
        """Return a new sample of the present load: tool on robot, the opposite of MuJoCo's."""
        row = self._counter % _DRAWN_AT_ONCE
        if row == 0:
            self._added = self._bias + self._noise * self._rng.standard_normal(self._added.shape)
        self._counter += 1
        value = self.wiring.dot(-self._on_tool) + self._added[row]
        saturated = any(map(ge, map(abs, value.tolist()), self._ranges))
        if saturated:
            np.clip(value, -self._range, self._range, out=value)
        value = np.rint(value / self._step) * self._step
        return FtSample(
            force_N=value[:3],
            torque_Nm=value[3:],
            status="saturated" if saturated else "ok",
            counter=self._counter,
        )
