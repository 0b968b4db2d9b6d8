"""Generator of docs/pictures/calibration.png: the demo's cell calibrated on a virtual clock.

`python -m tools.calibration_picture` takes about half a minute; it starts no process.
"""

from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread, imsave

from cli.calibration.page import attitudes, before_after, residual_bars
from cli.calibration.wizard import CalibrationWizard
from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.frames import Array
from common.motion.kinematics import ArmKinematics
from identification.evidence import Findings, evidence_of, findings_of
from identification.excitation.plan import PlanOptions, make_plan
from identification.verification import VerificationBounds
from launch.virtual_cell import VirtualCell

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "docs" / "pictures" / "calibration.png"
DPI = 100


class Silence:
    """Progress reporter without output."""

    def note(self, text: str) -> None:
        """Ignore the line."""

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Ignore the progress."""


def calibrated(cell: CellConfig) -> Findings:
    """Run the wizard in a virtual cell and return its findings."""
    world = VirtualCell(cell)
    world.advance(1.5)
    plan = make_plan(cell, ArmKinematics(cell.robot.model), world.arm.q, PlanOptions())
    client = ConfiguredCell(cell, bus=world.client)
    wizard = CalibrationWizard(client, plan, Silence())
    wizard.run()
    return findings_of(
        cell, evidence_of("arm", wizard.dwells, source=Path("demo.csv")), VerificationBounds()
    )


def pixels(figure: Figure) -> Array:
    """Return a figure as an image."""
    out = BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    out.seek(0)
    return np.asarray(imread(out))


def main() -> None:
    """Write the picture."""
    found = calibrated(load_cell(ROOT / "cells" / "demo.yaml"))
    drawn = [pixels(draw(found)) for draw in (residual_bars, before_after, attitudes)]
    imsave(OUT, np.ascontiguousarray(np.vstack(drawn)))
    print(f"{OUT.relative_to(ROOT)}: {found.verdict.text}")


if __name__ == "__main__":
    main()
