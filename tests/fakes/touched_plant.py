"""A plant for the regulator: a delayed arm, a contact and a hand, a sensor with false wiring."""

from collections import deque

import numpy as np

from common.config.cell import CellConfig
from common.motion.convert import pose_of, vec3
from common.motion.frames import Array
from forcemesh.messages import RobotState, WrenchAtTcp
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import T_FLANGE_TCP, RegulatorBench

LATE = 6  # periods from a pose to its force
HAND_N_M = 1500.0


class TouchedPlant(RegulatorBench):
    """A delayed arm; its contact is a spring."""

    def __init__(
        self, wiring: Array | None = None, *, axes_checked: bool = False, cell: CellConfig = CELL
    ) -> None:
        """Start without contact; `wiring` maps a force, base axes, to a reading, shape (3, 3)."""
        super().__init__(cell)
        self.robot: RobotState
        self.wiring = np.eye(3) if wiring is None else wiring
        self.checked, self.calibration = axes_checked, "cell file, tared"
        self.k_N_m = np.zeros(3)  # of a contact that sticks
        self.p_rest_m = self.p_m  # where it exerts no force
        self.p_hand_m: Array | None = None
        self.truth_N = np.zeros(3)
        self._poses: deque[RobotState] = deque([self.robot] * LATE, LATE)
        self._show()
        self.pass_s(0.1)

    @property
    def p_m(self) -> Array:
        """Position of the TCP."""
        return np.array((pose_of(self.robot) * T_FLANGE_TCP).translation)

    def touch(self, force_N: Array, k_N_m: Array) -> None:
        """Press with a force from now on, on a contact with that stiffness along the base axes."""
        self.k_N_m = k_N_m
        self.p_rest_m = self.p_m + np.divide(force_N, k_N_m, out=np.zeros(3), where=k_N_m > 0.0)
        self._show()
        self.step(10)

    def step(self, periods: int = 1) -> None:
        """Advance by periods: the arm follows late, the sensor shows the contact force."""
        for _ in range(periods):
            super().step()
            target = self.published()
            if target.valid and target.pose is not None:
                self._poses.append(self.robot.replaced(**target.pose.as_dict()))
            else:
                self._poses.append(self._poses[-1])
            self.robot = self._poses[0]
            self._show()

    @property
    def p_commanded_m(self) -> Array:
        """Position of the TCP when every command has arrived."""
        return np.array((pose_of(self._poses[-1]) * T_FLANGE_TCP).translation)

    def _show(self) -> None:
        self.truth_N = self.k_N_m * (self.p_rest_m - self.p_m)
        if self.k_N_m[2] > 0.0:
            self.truth_N[2] = max(self.truth_N[2], 0.0)  # a plate below does not pull
        if self.p_hand_m is not None:
            self.truth_N = self.truth_N + HAND_N_M * (self.p_hand_m - self.p_m)
        self.wrench = WrenchAtTcp(
            force_N=vec3(self.wiring @ self.truth_N),
            calibration=self.calibration,
            axes_checked=self.checked,
        )
