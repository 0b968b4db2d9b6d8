"""A cell whose arm is mounted on a wall, a ceiling or a slope, on a virtual clock."""

import numpy as np
import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.requests import MoveRequest
from tests.fakes.bench import DEMO
from tests.fakes.lab import Lab

MOUNTINGS = {
    "wall": ("demo", (1.0, 0.0, 0.0)),
    "ceiling": ("demo", (0.0, 0.0, 1.0)),
    "slope": ("demo", (0.48, -0.64, -0.6)),
    "wall, emulated controller": ("demo-tcp", (1.0, 0.0, 0.0)),
}
RESIDUAL_N = 0.5  # of noise and filter; the weight of the tool is 10 N


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_an_arm_mounted_in_any_direction_tares_arms_and_presses(mounting: str) -> None:
    """One key: the simulated weight and its compensation agree in every attitude."""
    name, down = MOUNTINGS[mounting]
    file = DEMO.with_name(f"{name}.yaml")
    lab = Lab(load_cell(file, {"gravity_direction_in_base": list(down)}))
    lab.press()
    lab.lift()
    lab.finish_move()
    turned = lab.target(x_m=0.02)
    assert lab.ask(topics.MOVE, MoveRequest(kind="pose", pose=turned)).accepted
    lab.finish_move()
    lab.cell.advance(0.3)
    assert np.linalg.norm(lab.now(lab.wrench).force_N) < RESIDUAL_N
