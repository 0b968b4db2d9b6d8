"""Whether the arm is sent what the law commands, or commands pile up before a stalled link. Pure.

The robot reports the set point that left for the arm last. Behind a link that works it is one that
was commanded a moment ago. Where it is farther from the newest command than any of the last

    window = delay + chain + 2 reports + 2 samples

the link lags: the law then stands still, because what it adds would leave all at once. What it has
added meanwhile was wanted by forces that the arm had not changed yet: it goes back to the oldest
command of the window, and begins anew from there.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.config.cell import Cell
from common.motion.frames import Array

REPORTS, SAMPLES = 2.0, 2.0
SAME = np.array([1e-5, 1e-4])  # m, rad: a pose that left is the one that was commanded

# Which squares of a row add up to the square of a way, and which, halved, to that of an angle.
WAY_AND_TURN = np.repeat([[1.0, 0.0], [0.0, 0.5]], [3, 9], axis=0)


@dataclass(frozen=True, slots=True)
class Commanded:
    """The commands of the last window, oldest first: age [s], and pose of the TCP in base."""

    window_s: float
    ages_s: Array  # shape (n,)
    poses: Array  # position and rotation matrix, row by row. Shape (n, 12)

    @classmethod
    def of(cls, cell: Cell) -> "Commanded":
        """Begin without a command; the window is that of a cell."""
        loop_s = cell.robot.delay_s + cell.force.chain_s
        reports_s = REPORTS / cell.rates.robot_hz
        window_s = loop_s + reports_s + SAMPLES / cell.rates.control_hz
        return cls(window_s, np.zeros(0), np.zeros((0, 12)))

    def after(self, T_base_tcp: pin.SE3, dt_s: float) -> "Commanded":
        """Return the commands after one more, `dt_s` after the last one."""
        ages_s = self.ages_s + dt_s
        first = int((-ages_s).searchsorted(-self.window_s))
        poses = np.concatenate((self.poses[first:], _row(T_base_tcp)))
        return Commanded(self.window_s, np.concatenate((ages_s[first:], (0.0,))), poses)

    @property
    def oldest(self) -> pin.SE3:
        """The command that should have left by now; one that lags is farther than SAME from it."""
        row = self.poses[0]
        return pin.SE3(row[3:].reshape(3, 3), row[:3])

    def anew(self) -> "Commanded":
        """Return the oldest command as the only one."""
        return Commanded(self.window_s, np.zeros(1), self.poses[:1])

    def lag(self, T_sent: pin.SE3 | None) -> bool:
        """Tell whether what left is behind every command of the window; None: nothing is known."""
        if T_sent is None or not len(self.ages_s):
            return False
        behind = _apart(_row(T_sent) - self.poses[-1:])[0]
        if (behind <= SAME).all():
            return False
        gone = _apart(self.poses - self.poses[-1]).max(axis=0)
        return bool((behind > gone + SAME).any())


def _row(T: pin.SE3) -> Array:
    """Return a pose as one row. Shape (1, 12)."""
    return np.concatenate((T.translation, T.rotation.ravel()))[None, :]


def _apart(differences: Array) -> Array:
    """Return distances [m] and small angles [rad] of poses. Shapes (n, 12), (n, 2).

    Two rotation matrices differ by sqrt(2) times the angle between them.
    """
    return np.asarray(np.sqrt((differences * differences).dot(WAY_AND_TURN)))
