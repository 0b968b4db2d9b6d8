"""A cell whose arm has no folder in arms/."""

from pathlib import Path

from common.config.cell import CellConfig
from common.config.load import load_cell

CELLS = Path(__file__).resolve().parents[2] / "cells"


def unknown_arm() -> CellConfig:
    """Return a real cell that gives the joint limits of an arm without a model."""
    limits = {
        "robot.model": "unknown",
        "robot.joint_min_deg": [-170.0] * 6,
        "robot.joint_max_deg": [170.0] * 6,
        "robot.joint_speed_max_deg_s": [180.0] * 6,
    }
    return load_cell(CELLS / "rs007l-real.yaml", limits)
