"""What the emulated arm was commanded to do, millisecond by millisecond."""

import numpy as np

from tests.fakes.as_bench import AsBench

SQUARE = ("HERE p", "SPEED 100 MM/S ALWAYS")  # how most test programs begin


class Trace:
    """What the arm did: commanded TCP each millisecond."""

    def __init__(self, bench: AsBench) -> None:
        self.points: list[np.ndarray] = []
        self._bench = bench
        self._look()
        bench.machine.after_tick.append(self._look)

    def _look(self) -> None:
        robot = self._bench.robot
        self.points.append(robot.pose_of(robot.queue.q_command).translation * 1e3)

    @property
    def mm(self) -> np.ndarray:
        """Where the command was [mm]. Shape (n, 3)."""
        return np.array(self.points)

    @property
    def speed_mm_s(self) -> np.ndarray:
        """How fast it was. Shape (n - 1,)."""
        return np.linalg.norm(np.diff(self.mm, axis=0), axis=1) * 1e3
