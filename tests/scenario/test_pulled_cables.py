"""The cable to the controller is pulled a hundred times while the tool presses, in each host.

A broken connection is a standing error here and ends every program, the robot program too: what
users of such controllers report. Gateway, program and arm are real, the clock is virtual.
"""

from pathlib import Path
from typing import get_args

import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import Host
from forcemesh.requests import Empty
from sim.controller.network import MemoryNetwork, MemoryStream
from tests.fakes.lab import BRAKE_S, PRESS_N, Lab

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

TCP_CELL = load_cell(Path(__file__).resolve().parents[2] / "cells" / "demo-tcp.yaml")
PULLS = 100
BACK_S = 8.0
STANDING = {"tcp_error_stands": True, "pc_error_stops_robot": True}


@pytest.mark.parametrize("host", get_args(Host))
def test_the_arm_holds_each_time_and_the_link_returns_without_the_pendant(
    host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the pendant: a person arms again on the PC, and it presses again."""
    cables: list[MemoryStream] = []

    def dial(network: MemoryNetwork, *where: object) -> MemoryStream:
        cables.append(dialled(network, *where))  # type: ignore[arg-type]
        return cables[-1]

    dialled = MemoryNetwork.dial
    monkeypatch.setattr(MemoryNetwork, "dial", dial)
    lab = Lab(TCP_CELL)
    machine = lab.machine
    machine.hardware.behaviour = machine.hardware.behaviour.model_copy(update=STANDING)
    for _ in range(PULLS):
        lab.press(host)
        cables[-1].reset()
        lab.seconds_until(lambda: not lab.status.operational, 0.3)
        lab.cell.advance(BRAKE_S)
        lab.assert_still(0.5)
        assert lab.force_N < 1.3 * PRESS_N
        lab.seconds_until(lambda: lab.state.valid and machine.control.error is None, BACK_S)
        lab.assert_still(1.2)  # good inputs for a second, before it can be armed
        assert lab.ask(topics.CLEAR, Empty()).accepted
        assert lab.ask(topics.ARM, Empty()).accepted
        lab.cell.advance(0.05)
    # A connection that is made while the programs restart may end in another error.
    resets = machine.memory.read("fm.eres")
    assert isinstance(resets, float)
    assert PULLS <= resets <= 1.1 * PULLS
