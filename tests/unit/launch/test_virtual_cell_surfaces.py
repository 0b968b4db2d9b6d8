"""Curved surfaces in place of the plate, in a whole cell with either simulated robot."""

import numpy as np
import pytest

from common.config.load import load_cell
from common.motion.convert import pose_of, record_of
from forcemesh import topics
from forcemesh.requests import ForceStartRequest, MoveRequest
from tests.fakes.bench import DEMO
from tests.fakes.lab import FOUND_PART, FOUND_S, PRESS_N, SETTLED_S, Lab

K_N_M, RADIUS_M, DISC_M, ASIDE_M = 2e4, 0.1, 0.01, 0.025
ALONG_TOOL = (False, False, True, False, False, False)
PLACE_M = ASIDE_M - DISC_M  # of the rim that touches, from the top


@pytest.mark.parametrize("surface", ["cylinder", "hemisphere"])
@pytest.mark.parametrize("cell", ["demo.yaml", "demo-tcp.yaml"])
def test_beside_the_top_the_surface_is_lower_and_pushes_aside(cell: str, surface: str) -> None:
    """The simulated robot and the emulated controller have the arm with the cell's surface."""
    chosen = {
        "sim.surface": surface, "sim.radius_m": RADIUS_M, "sim.disc_radius_m": DISC_M,
        "sim.stiffness_N_m": K_N_M,
    }  # fmt: skip
    lab = Lab(load_cell(DEMO.parent / cell, chosen))
    T_base_flange = pose_of(lab.state)
    T_base_flange.translation = T_base_flange.translation + np.array([ASIDE_M, 0.0, 0.0])
    assert lab.ask(topics.MOVE, MoveRequest(kind="pose", pose=record_of(T_base_flange))).accepted
    lab.finish_move()
    start = ForceStartRequest(mode="position", setpoint_N=PRESS_N, axes=ALONG_TOOL, frame="tool")
    assert lab.ask(topics.FORCE_START, start).accepted
    lab.seconds_until(lambda: lab.force_N > FOUND_PART * PRESS_N, FOUND_S)
    lab.cell.advance(SETTLED_S)
    arm, slope = lab.cell.arm, PLACE_M / RADIUS_M
    force_N = arm.true_wrench().force_N
    normal = np.array([slope, 0.0, np.sqrt(1.0 - slope**2)])
    assert force_N[2] == pytest.approx(PRESS_N, abs=1.0)
    assert normal @ force_N == pytest.approx(K_N_M * -arm.lift_off_m, rel=0.05)
    fallen_m = arm.plate.point_m[2] - arm.T_base_tcp.translation[2]
    assert fallen_m == pytest.approx(RADIUS_M * (1.0 - normal[2]) + PRESS_N / K_N_M, abs=3e-4)
