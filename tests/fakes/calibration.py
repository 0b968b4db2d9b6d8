"""A virtual cell that is calibrated, with a teller whose lines a test reads."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from cli.calibration.wizard import CalibrationWizard, WizardTiming
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
FAST = WizardTiming(speed_m_s=0.8, dwell_s=0.3)


def demo_cell(**overrides: Any) -> CellConfig:
    """Return the demo's cell without any calibration."""
    return load_cell(DEMO, {"calibration": None, **overrides})


@cache
def planned(cell: CellConfig, q_start: tuple[float, ...], options: PlanOptions) -> CalibrationPlan:
    """Return a plan, made once for all who begin at the same joint angles [rad]."""
    return make_plan(cell, ArmKinematics(), np.array(q_start), options)


class Notes:
    """A teller: keeps the lines, and lets a test do something at a certain stage."""

    def __init__(self) -> None:
        """Begin with no line."""
        self.lines: list[str] = []
        self.stages: list[str] = []
        self.shares: list[float] = []
        self._events: list[tuple[str, Callable[[], None]]] = []

    def note(self, text: str) -> None:
        """Keep a line."""
        self.lines.append(text)

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Keep what changes, and do what was asked for at this stage, once."""
        if not self.stages or self.stages[-1] != text:
            self.stages.append(text)
        self.shares.append(done_s / total_s if total_s else 0.0)
        for event in self._events:
            if event[0] in text:
                self._events.remove(event)
                event[1]()
                return

    def at(self, text: str, do: Callable[[], None]) -> None:
        """Do something the first time that a stage holds a text."""
        self._events.append((text, do))


class CalibrationLab:
    """The cell on a virtual clock, at home and ready to be armed."""

    def __init__(self, cell: CellConfig | None = None) -> None:
        """Wait out the preflight."""
        self.cell = cell or demo_cell(**QUICK)
        self.world = VirtualCell(self.cell)
        self.world.advance(1.2)
        self.notes = Notes()

    @property
    def bus(self):
        """A client's way to the cell."""
        return self.world.client

    def plan(self, **options: Any) -> CalibrationPlan:
        """Return a plan from where the arm is."""
        wanted = PlanOptions(**{"poses": 6, "verify_poses": 2, **options})
        return planned(self.cell, tuple(self.world.arm.q.tolist()), wanted)

    def wizard(
        self, plan: CalibrationPlan | None = None, pace: WizardTiming = FAST
    ) -> CalibrationWizard:
        """Return a wizard that has not begun."""
        return CalibrationWizard(
            self.bus, self.cell, plan or self.plan(), timing=pace, output=self.notes
        )
