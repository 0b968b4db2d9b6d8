"""Command 4 without force feedback in the controller, for a display or a log there."""

from typing import Any

import pytest

from common.motion.convert import record_of
from controller.packet_table import Com
from forcemesh.messages import WrenchAtTcp
from tests.contract.rig import shifted
from tests.contract.robots import Emulated
from tests.fakes.gateway_cell import GatewayCell, a_cell

SHOWN: dict[str, Any] = {"gateway.send_wrench": True}
WRENCH = WrenchAtTcp(force_N=(1.0, 0.0, 12.0), torque_Nm=(0.1, 0.2, 0.3))


def streaming(duration_s: float = 1.0, **overrides: Any) -> GatewayCell:
    """Stream set points for a second while 12 N act along z."""
    cell = a_cell(**overrides)
    cell.rig.connect()
    cell.rig.arm()
    cell.rig.wrench = WRENCH
    cell.rig.send("setpoint", pose=record_of(shifted(cell.rig.T, z_m=0.002)))
    cell.rig.advance(duration_s)
    assert cell.rig.state.hold_reason == ""
    return cell


def test_the_reading_is_sent_at_the_rate_of_a_status_if_the_cell_asks_for_it() -> None:
    """20 times a second; nothing else changes."""
    cell = streaming(**SHOWN)
    shown = cell.controller.of(Com.WRENCH)
    assert len(shown) == pytest.approx(20, abs=2)
    assert {packet.vec for packet in shown} == {(100, 0, 1200, 100, 200, 300)}
    assert cell.controller.of(Com.FORCE_SET_POINT) == []
    assert cell.coms().count(Com.SET_POINT) == streaming().coms().count(Com.SET_POINT)


def test_it_is_sent_while_idle_and_not_in_a_hold_nor_by_default_nor_without_a_wrench() -> None:
    """While armed, whatever is commanded, and only what was measured."""
    assert streaming().controller.of(Com.WRENCH) == []
    cell = streaming(**SHOWN)
    for kind, more in (("idle", 10), ("hold", 0)):
        sent = len(cell.controller.of(Com.WRENCH))
        cell.rig.send_hold() if kind == "hold" else cell.rig.send(kind)
        cell.rig.advance(0.5)
        assert len(cell.controller.of(Com.WRENCH)) - sent == pytest.approx(more, abs=1)
    silent = a_cell(**SHOWN)
    silent.rig.connect()
    silent.rig.arm()
    silent.rig.send("setpoint", pose=record_of(silent.rig.T))
    silent.rig.advance(0.5)
    assert silent.controller.of(Com.WRENCH) == []


def test_the_shipped_program_takes_it_without_a_motion() -> None:
    """It has the newest reading; the arm goes to the set point, not by the force."""
    cell = Emulated(host="pc", **SHOWN)
    cell.rig.connect()
    cell.rig.arm()
    target = shifted(cell.rig.T, z_m=0.002)
    cell.rig.wrench = WRENCH
    cell.rig.send("setpoint", pose=record_of(target))
    cell.rig.advance(1.5)
    received = cell.machine.memory.read("fm.wn")
    assert isinstance(received, float)
    assert received > 10
    assert cell.machine.memory.read("fm.mode") == 0
    assert cell.rig.state.hold_reason == ""
    assert abs(cell.rig.T.translation - target.translation).max() < 1e-4
