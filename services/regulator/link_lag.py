"""Detector of a stalled link: commands accumulate instead of being sent to the arm. Pure.

The robot reports the set point it sent last. On a working link that is a recent command. If it is
farther from the newest command than every command of the last

    window = delay + chain + 2 reports + 2 samples

the link lags. The law then stands still, because accumulated commands would be sent as one step.
Commands added meanwhile came from forces that the arm had not changed yet: the law returns to the
oldest command of the window and restarts from there.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array

REPORTS, SAMPLES = 2.0, 2.0
SAME_COMMAND = np.array([1e-5, 1e-4])  # m, rad: tolerance between a sent pose and its command

# Weights that sum the squared elements of a row to a squared distance and a squared small angle:
# two rotation matrices differ by sqrt(2) times the angle between them.
SQUARE_WEIGHTS = np.tile([[0.0, 0.5], [0.0, 0.5], [0.0, 0.5], [1.0, 0.0]], (4, 1))


@dataclass(frozen=True, slots=True)
class CommandHistory:
    """Commands of the last window, oldest first: age [s], and pose of the TCP in base."""

    window_s: float
    ages_s: Array  # shape (n,)
    poses: Array  # homogeneous matrices, row by row. Shape (n, 16)

    @classmethod
    def of(cls, cell: CellConfig) -> "CommandHistory":
        """Return an empty history with the window of a cell."""
        loop_s = cell.robot.delay_s + cell.force.chain_s
        reports_s = REPORTS / cell.rates.robot_hz
        window_s = loop_s + reports_s + SAMPLES / cell.rates.control_hz
        return cls(window_s, np.zeros(0), np.zeros((0, 16)))

    def after(self, T_base_tcp: pin.SE3, dt_s: float) -> "CommandHistory":
        """Return the history with one more command, `dt_s` after the last one."""
        ages_s = self.ages_s + dt_s
        first = int((-ages_s).searchsorted(-self.window_s))
        poses = np.concatenate((self.poses[first:], T_base_tcp.homogeneous.reshape(1, 16)))
        return CommandHistory(self.window_s, np.concatenate((ages_s[first:], (0.0,))), poses)

    @property
    def oldest(self) -> pin.SE3:
        """Oldest command, which should have been sent by now."""
        return pin.SE3(self.poses[0].reshape(4, 4))

    def restarted(self) -> "CommandHistory":
        """Return a history with the oldest command only."""
        return CommandHistory(self.window_s, np.zeros(1), self.poses[:1])

    def lag(self, T_sent: pin.SE3 | None) -> bool:
        """Return whether the sent pose is behind every command of the window; None: unknown."""
        if T_sent is None or not len(self.ages_s):
            return False
        poses = np.concatenate((T_sent.homogeneous.reshape(1, 16), self.poses))
        squares = (poses - self.poses[-1]) ** 2
        from_newest = np.sqrt(squares.dot(SQUARE_WEIGHTS))  # m, rad. Shape (n + 1, 2)
        return bool((from_newest[0] > from_newest[1:].max(axis=0) + SAME_COMMAND).any())
