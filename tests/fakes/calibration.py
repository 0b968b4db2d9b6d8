"""A calibrated virtual cell, and a recorder of the wizard's progress lines."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.kinematics import ArmKinematics
from identification.excitation.plan import CalibrationPlan, PlanOptions, make_plan
from launch.virtual_cell import VirtualCell
from tests.fakes.bench import DEMO, HALF_RATES

HOME_RAD = np.radians([0.0, 0.0, -90.0, 0.0, -90.0, 0.0])
QUICK: dict[str, Any] = {
    "limits.speed_m_s": 1.0,  # the cell file's own limit would take minutes of virtual time
    "rates": HALF_RATES,
}
FAST: dict[str, Any] = {"poses": 6, "verify_poses": 2, "speed_m_s": 0.8, "dwell_s": 0.3}


def demo_cell(**overrides: Any) -> CellConfig:
    """Return the demo's cell without any calibration."""
    return load_cell(DEMO, overrides)


@cache
def planned(cell: CellConfig, q_start: tuple[float, ...], options: PlanOptions) -> CalibrationPlan:
    """Return a plan, computed once for all tests with the same initial joint angles [rad]."""
    return make_plan(cell, ArmKinematics(cell.robot.model), np.array(q_start), options)


class Notes:
    """Progress output: keeps the lines, and runs a test's function at a certain stage."""

    def __init__(self) -> None:
        """Start without lines."""
        self.lines: list[str] = []
        self._events: list[tuple[str, Callable[[], object]]] = []

    def note(self, text: str) -> None:
        """Keep a line."""
        self.lines.append(text)

    def progress(self, _done_s: float, _total_s: float, text: str) -> None:
        """Run the function of this stage, once."""
        for event in self._events:
            if event[0] in text:
                self._events.remove(event)
                event[1]()
                return

    def at(self, text: str, do: Callable[[], object]) -> None:
        """Run a function the first time that a stage contains a text."""
        self._events.append((text, do))


class CalibrationLab:
    """The cell on a virtual clock, at home and ready to be armed."""

    def __init__(self, cell: CellConfig | None = None) -> None:
        """Advance past the preflight."""
        self.cell = cell or demo_cell(**QUICK)
        self.world = VirtualCell(self.cell)
        self.world.advance(1.2)
        self.notes, self.bus = Notes(), self.world.client
        self.client = ConfiguredCell(self.cell, bus=self.bus)

    def plan(self, **options: Any) -> CalibrationPlan:
        """Return a plan from the present pose."""
        plan_options = PlanOptions(**{**FAST, **options})
        return planned(self.cell, tuple(self.world.arm.q.tolist()), plan_options)
