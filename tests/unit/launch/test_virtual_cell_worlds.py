"""Whole cells on a virtual clock: mounted on a wall, with seven joints, slowed by command 5."""

from pathlib import Path

import numpy as np
import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import Host, Speed
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, MoveRequest
from launch.virtual_cell import VirtualCell
from sim.controller.service import ControllerSensor
from sim.robot.scene import plate_at_rest
from tests.fakes.bench import DEMO
from tests.fakes.lab import PRESS_N, Lab
from tools.tree import ROOT

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


SLOW_M_S = 0.002


def fastest_m_s(world: VirtualCell, duration_s: float) -> float:
    """Return the highest mean speed of the flange in 0.2 s: a segment takes 33 ms."""
    fastest = 0.0
    for _ in range(round(5 * duration_s)):
        before = world.arm.T_base_flange.translation.copy()
        world.advance(0.2)
        step = world.arm.T_base_flange.translation - before
        fastest = max(fastest, 5.0 * float(np.linalg.norm(step)))
    return fastest


@pytest.mark.parametrize(
    ("name", "host", "own"),
    [("demo", "pc", ""), ("demo-tcp", "pc", "fm.v"), ("demo-tcp", "controller", "fm.lspeed"),
     ("demo-plain", "controller", "pl.v")],
)  # fmt: skip
def test_force_control_is_no_faster_than_command_5(name: str, host: Host, own: str) -> None:
    """2 mm/s on the way to contact; the controller's own speed stays above it, or it is delay."""
    world = VirtualCell(load_cell(ROOT / "cells" / f"{name}.yaml", {"calibration": "none"}))
    ask = world.client.ask
    world.advance(3.0)
    assert ask(topics.TARE, Empty()).accepted
    world.advance(1.0)
    assert ask(topics.SPEED, Speed(mechanical_m_s=2 * SLOW_M_S, modular_fraction=0.5)).accepted
    assert ask(topics.ARM, ArmRequest()).accepted
    start = ForceStartRequest(mode="position", host=host, setpoint_N=10.0)
    assert ask(topics.FORCE_START, start).accepted
    world.advance(0.5)
    assert 0.5 * SLOW_M_S < fastest_m_s(world, 1.0) < 1.1 * SLOW_M_S
    if own:
        controller = world.runners["sensor"].service
        assert isinstance(controller, ControllerSensor)
        speed_mm_s = controller.machine.memory.read(own)
        assert isinstance(speed_mm_s, float)
        assert speed_mm_s >= 10e3 * SLOW_M_S


PANDA = Path(__file__).resolve().parents[3] / "cells" / "panda.yaml"
SETTLED_N, SETTLED_NM = 1.0, 0.1


@pytest.fixture(scope="module")
def lab() -> Lab:
    """The armed cell over a tilted plate."""
    return Lab(load_cell(PANDA, {"sim.tilt_deg": 5.0}))


def test_force_control_settles(lab: Lab) -> None:
    """Force and torque reach their set points on a plate that is tilted by five degrees."""
    start = ForceStartRequest(mode="both", setpoint_N=PRESS_N)
    assert lab.ask(topics.FORCE_START, start).accepted
    lab.cell.advance(4.0)
    for _ in range(10):
        lab.cell.advance(0.1)
        wrench = lab.now(lab.wrench)
        assert np.linalg.norm(wrench.force_N) == pytest.approx(PRESS_N, abs=SETTLED_N)
        assert np.linalg.norm(wrench.torque_Nm) < SETTLED_NM
    tool, normal = (
        lab.cell.arm.T_base_tcp.rotation[:, 2],
        plate_at_rest(lab.cell.arm.settings).normal,
    )
    assert np.degrees(np.arccos(-tool @ normal)) < 0.5
    assert lab.status.state == "ACTIVE"
