"""Detector of a stalled link: commands accumulate instead of being sent to the arm. Pure.

The robot reports the set point it sent last. On a working link that is a recent command. If it is
farther from the newest command than every command of the last

    window = delay + chain + 2 reports + 2 samples

the link lags. The law then stands still, because accumulated commands would be sent as one step.
Commands added meanwhile came from forces that the arm had not changed yet: the law returns to the
oldest command of the window and restarts from there.
"""

from collections import deque
from dataclasses import dataclass, field
from math import acos, dist
from operator import mul

from common.config.cell import CellConfig
from forcemesh.messages import PoseRecord

REPORTS, SAMPLES = 2.0, 2.0
SAME_M, SAME_RAD = 1e-5, 1e-4  # tolerance between a sent pose and its command


@dataclass(slots=True)
class CommandHistory:
    """Commands of the last window, oldest first: time [s], and pose of the flange in base."""

    window_s: float
    commands: deque[tuple[float, PoseRecord]] = field(default_factory=deque)
    now_s: float = 0.0

    @classmethod
    def of(cls, cell: CellConfig) -> "CommandHistory":
        """Return an empty history with the window of a cell."""
        plant = cell.plant
        return cls(plant.arm.delay_s + REPORTS / plant.robot_hz + SAMPLES / plant.control_hz)

    def lags(self, command: PoseRecord, dt_s: float, sent: PoseRecord | None) -> bool:
        """Add a command; return whether the sent pose is behind every command of the window.

        Args:
            command: The command.
            dt_s: Time since the last one.
            sent: Pose that the robot has sent last; None: unknown, which is no lag.
        """
        self.now_s += dt_s
        commands = self.commands
        while commands and commands[0][0] < self.now_s - self.window_s:
            commands.popleft()
        commands.append((self.now_s, command))
        if sent is None:
            return False
        p_m, behind_m = command.position_m, dist(command.position_m, sent.position_m) - SAME_M
        behind_rad = _angle_rad(command, sent) - SAME_RAD
        # The oldest one is mostly far enough from the newest.
        lags = all(dist(p_m, each.position_m) < behind_m for _, each in commands)
        return lags or all(_angle_rad(command, each) < behind_rad for _, each in commands)

    def restart(self) -> PoseRecord:
        """Keep only the oldest command, which should have been sent by now; return it."""
        _, oldest = self.commands[0]
        self.commands = deque([(self.now_s, oldest)])
        return oldest


def _angle_rad(a: PoseRecord, b: PoseRecord) -> float:  # to 1e-7
    return 2.0 * acos(min(abs(sum(map(mul, a.orientation_xyzw, b.orientation_xyzw))), 1.0))
