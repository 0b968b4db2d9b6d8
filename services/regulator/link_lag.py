"""Detector of a stalled link: commands accumulate instead of being sent to the arm. Pure.

The robot reports the set point it sent last. On a working link that is a recent command. If it is
farther from the newest command than every command of the last

    window = delay + chain + 2 reports + 2 samples

the link lags. The law then stands still, because accumulated commands would be sent as one step.
Commands added meanwhile came from forces that the arm had not changed yet: the law returns to the
oldest command of the window and restarts from there.
"""

from dataclasses import dataclass, field

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import apart

REPORTS, SAMPLES = 2.0, 2.0
SAME_M, SAME_RAD = 1e-5, 1e-4  # tolerance between a sent pose and its command


@dataclass(slots=True)
class CommandHistory:
    """Commands of the last window, oldest first: age [s], and pose of the TCP in base."""

    window_s: float
    commands: list[tuple[float, pin.SE3]] = field(default_factory=list)

    @classmethod
    def of(cls, cell: CellConfig) -> "CommandHistory":
        """Return an empty history with the window of a cell."""
        loop_s = cell.robot.delay_s + cell.force.chain_s
        reports_s = REPORTS / cell.rates.robot_hz
        return cls(loop_s + reports_s + SAMPLES / cell.rates.control_hz)

    def lags(self, T_base_tcp: pin.SE3, dt_s: float, T_sent: pin.SE3 | None) -> bool:
        """Add a command; return whether the sent pose is behind every command of the window.

        Args:
            T_base_tcp: The command.
            dt_s: Time since the last one.
            T_sent: Pose that the robot has sent last; None: unknown, which is no lag.
        """
        older = [(age_s + dt_s, T) for age_s, T in self.commands if age_s + dt_s <= self.window_s]
        self.commands = [*older, (0.0, T_base_tcp)]
        if T_sent is None:
            return False
        behind_m, behind_rad = apart(T_base_tcp, T_sent)
        is_behind, is_turned = behind_m > SAME_M, behind_rad > SAME_RAD
        for _, T in older:  # the oldest one is mostly far enough from the newest
            if not is_behind and not is_turned:
                break
            distance_m, angle_rad = apart(T_base_tcp, T)
            is_behind = is_behind and behind_m > distance_m + SAME_M
            is_turned = is_turned and behind_rad > angle_rad + SAME_RAD
        return is_behind or is_turned

    def restart(self) -> pin.SE3:
        """Keep only the oldest command, which should have been sent by now; return it."""
        _, T_oldest = self.commands[0]
        self.commands = [(0.0, T_oldest)]
        return T_oldest
