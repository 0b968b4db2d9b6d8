"""A virtual cell that presses, with its true forces."""

import numpy as np

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.messages import RegulatorTarget
from forcemesh.requests import ForceStartRequest
from tests.fakes.lab import Lab


class Press(Lab):
    """A cell whose force feedback has started in mode position."""

    def __init__(self, cell: CellConfig, setpoint_N: float) -> None:
        """Tare, arm, start."""
        super().__init__(cell)
        self._target = self.cell.client.reader(topics.REGULATOR_TARGET)
        self.start(setpoint_N)

    def start(self, setpoint_N: float) -> None:
        """Start with a set point, or change it."""
        request = ForceStartRequest(mode="position", setpoint_N=setpoint_N)
        assert self.ask(topics.FORCE_START, request).accepted

    @property
    def published(self) -> RegulatorTarget:
        """Newest target of the regulator."""
        target: RegulatorTarget = self.now(self._target)
        return target

    def true_N(self) -> float:
        """Return the true contact force of the plate."""
        return float(np.linalg.norm(self.cell.arm.true_wrench().force_N))

    def forces_N(self, duration_s: float) -> np.ndarray:
        """Let time pass; return the true contact force of each millisecond."""
        forces = []
        for _ in range(round(duration_s * 1000)):
            self.cell.advance(0.001)
            forces.append(self.true_N())
        return np.array(forces)

    def height_m(self) -> float:
        """Return the true height of the tool."""
        return float(self.cell.arm.T_base_tcp.translation[2])

    def stop_code(self, at_most_s: float) -> str:
        """Wait until the regulator has stopped and the arm has braked; return the code."""
        self.cell.advance(at_most_s, lambda: not self.published.valid)
        assert not self.published.valid
        code = self.published.code
        self.cell.advance(0.3)
        assert code in {trip.code for trip in self.status.trips}
        return code
