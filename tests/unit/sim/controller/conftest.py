"""Record of the emulated arm's commanded TCP, one sample a millisecond."""

import numpy as np

from tests.fakes.as_bench import AsBench

SQUARE = ("HERE p", "SPEED 100 MM/S ALWAYS")  # first steps of most test programs


class Trace:
    """Commanded TCP of each millisecond."""

    def __init__(self, bench: AsBench) -> None:
        self.points: list[np.ndarray] = []
        self._bench = bench
        self._record()
        bench.machine.after_tick.append(self._record)

    def _record(self) -> None:
        robot = self._bench.robot
        self.points.append(robot.pose_of(robot.queue.q_command).translation * 1e3)

    @property
    def mm(self) -> np.ndarray:
        """Commanded positions [mm]. Shape (n, 3)."""
        return np.array(self.points)

    @property
    def speed_mm_s(self) -> np.ndarray:
        """Commanded speeds. Shape (n - 1,)."""
        return np.linalg.norm(np.diff(self.mm, axis=0), axis=1) * 1e3
