"""Emergency stop and motor power off while the tool presses, in a whole cell over TCP, then reset.

The real gateway, the shipped controller program, and everything behind them on a virtual clock.
"""

from pathlib import Path

import numpy as np
import pytest

from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from common.motion.convert import vec3
from forcemesh.messages import Host
from sim.controller.machine import Pendant
from tests.fakes.lab import BRAKE_S, PRESS_N, Lab

TCP_CELL = load_cell(Path(__file__).resolve().parents[4] / "cells" / "demo-tcp.yaml")
HELD_S, NAMED_S = 0.2, 1.0  # the hold may be reported first, its cause a report later
SANK_RAD = (0.0, -0.004, 0.0, 0.0, 0.0, 0.0)  # of the joints while nothing but the brakes holds
UP_M = 0.01
CUTS = {
    "emergency stop": lambda pendant: pendant.emergency_stop(),
    "motor power off": lambda pendant: pendant.motor_power(on=False),
}


def reset(pendant: Pendant) -> None:
    """Reset the controller as a person does before the program may continue."""
    pendant.release_emergency_stop()
    pendant.motor_power(on=True)
    pendant.error_reset()
    pendant.run()


@pytest.mark.parametrize(
    ("cut", "host"),
    [
        ("emergency stop", "controller"),
        ("motor power off", "pc"),
        pytest.param("emergency stop", "pc", marks=pytest.mark.long),
        pytest.param("motor power off", "controller", marks=pytest.mark.long),
    ],
)
def test_power_that_goes_while_it_presses_is_not_made_up_for_when_it_comes_back(
    cut: str, host: Host
) -> None:
    """Held at once and under its name; after the reset held; armed again it stands where it is."""
    lab = Lab(TCP_CELL)
    lab.press(host)
    machine = lab.machine
    CUTS[cut](machine.pendant)
    lab.seconds_until(lambda: not lab.status.operational, HELD_S)
    lab.seconds_until(lambda: lab.state.hold_code == "robot_motors", NAMED_S)
    lab.cell.advance(BRAKE_S)
    lab.assert_still(0.5)
    assert lab.force_N < 1.3 * PRESS_N

    machine.robot.queue.reseed(machine.robot.q + np.array(SANK_RAD))
    lab.cell.advance(1.0)
    reset(machine.pendant)
    lab.assert_still(1.0)
    assert not lab.status.operational

    client = ConfiguredCell(lab.cell.cell, commander="operator", bus=lab.cell.client)
    lab.cell.advance(1.2)
    sank_m = lab.p_m()
    client.clear()
    assert client.arm("jog").accepted
    lab.assert_still(0.5)
    client.jog(vec3(np.array([0.0, 0.0, UP_M])))
    assert lab.p_m() == pytest.approx(sank_m + np.array([0.0, 0.0, UP_M]), abs=5e-4)
    client.hold()
    lab.cell.advance(1.2)
    assert client.arm("all").accepted
    lab.press(host)
