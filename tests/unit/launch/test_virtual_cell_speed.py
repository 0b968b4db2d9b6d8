"""Command 5 as a limit of force control: streams of set points and force feedback keep it."""

import numpy as np
import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import Host, Speed
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest
from launch.virtual_cell import VirtualCell
from sim.controller.service import ControllerSensor
from tools.tree import ROOT

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
