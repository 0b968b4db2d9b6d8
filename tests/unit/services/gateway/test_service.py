"""The gateway as a process: configuration, reports without a controller, readings for a display."""

from typing import Any

import pytest

from common.bus.memory_bus import MemoryTransport
from common.motion.convert import record_of
from controller.packet_table import ID_COUNT, ID_FIRST
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.errors import ConfigError
from forcemesh.messages import WrenchAtTcp
from services.gateway.service import Gateway
from tests.contract.rig import shifted
from tests.contract.robots import Emulated
from tests.fakes.bench import CELL
from tests.fakes.gateway_world import STEP_NS, FaultyController, GatewayWorld


def test_a_gateway_without_its_section_reports_what_is_missing() -> None:
    """A simulated cell has no such section, and this process can be started by hand."""
    assert CELL.gateway is None
    with pytest.raises(ConfigError) as caught:
        Gateway(Bus("robot", CELL.cell, MemoryTransport(), CELL, ManualClock()), CELL)
    assert caught.value.mistakes == ["gateway: the section is missing"]


def test_without_a_controller_the_fault_is_published_at_the_usual_rate() -> None:
    """With its reason; the connection is counted when it is made again, and begins with a hold."""
    world = GatewayWorld()
    world.controller.close("unplugged", world.clock.now_ns())
    world.controller._again_ns = world.clock.now_ns() + 2 * NS_PER_S
    world.live(5)
    world.states.clear()
    world.live(NS_PER_S // STEP_NS)
    assert len(world.states) == pytest.approx(world.cell.rates.robot_hz, rel=0.02)
    state = world.states[-1]
    assert (state.valid, state.reason, state.code) == (False, "unplugged", "robot_link")
    assert (state.link.connected, state.link.reconnects) == (False, 0)
    world.live(2 * NS_PER_S // STEP_NS)
    state = world.states[-1]
    assert (state.valid, state.link.connected, state.link.reconnects) == (True, True, 1)
    assert state.hold_reason
    assert world.gateway.counters()["reconnects"] == 1


@pytest.mark.parametrize("epoch", [7, ID_COUNT + 99])
def test_a_new_process_does_not_continue_the_ids_of_the_old_one(epoch: int) -> None:
    """Otherwise it would take reports about old commands for its own."""
    controller = FaultyController()
    GatewayWorld(controller, epoch=epoch)
    assert int(controller.sent[0][:6]) == ID_FIRST + epoch % ID_COUNT + 1


def test_at_its_end_it_closes_the_connection() -> None:
    """The controller holds then."""
    world = GatewayWorld()
    world.gateway.close()
    assert world.controller.last_fault == "closed by the gateway"


WRENCH = WrenchAtTcp(force_N=(1.0, 0.0, 12.0), torque_Nm=(0.1, 0.2, 0.3))


class ShownWrench:
    """A cell whose gateway streams set points; the shipped program counts the readings."""

    def __init__(self, wrench: WrenchAtTcp | None = WRENCH, *, is_asked_for: bool = True) -> None:
        """Connect and arm; the cell file asks for it or not."""
        overrides: dict[str, Any] = {"gateway.send_wrench": is_asked_for}
        self.cell = Emulated(host="pc", **overrides)
        self.rig = self.cell.rig
        self.rig.connect()
        self.rig.arm()
        self.rig.wrench = wrench
        self.target = shifted(self.rig.T, z_m=0.002)
        self.rig.send("setpoint", pose=record_of(self.target))
        self.rig.advance(1.0)

    def readings(self, duration_s: float = 1.0) -> float:
        """Return how many readings the program receives in a time."""
        before = self.cell.machine.memory.read("fm.wn")
        self.rig.advance(duration_s)
        return float(self.cell.machine.memory.read("fm.wn")) - float(before)  # type: ignore[arg-type]


def test_the_reading_is_sent_at_the_rate_of_a_status_and_moves_nothing() -> None:
    """20 times a second while armed, whatever is commanded; not in a hold."""
    shown = ShownWrench()
    memory = shown.cell.machine.memory
    assert shown.readings() == pytest.approx(20, abs=2)
    assert shown.rig.state.hold_reason == ""
    assert abs(shown.rig.T.translation - shown.target.translation).max() < 1e-4
    bank = int(float(memory.read("fm.wb")))  # type: ignore[arg-type]
    units = [memory.read(f"fm.w[{bank},{k}]") for k in range(1, 7)]
    assert units == [100, 0, 1200, 100, 200, 300]
    assert (memory.read("fm.mode"), memory.read("fm.zn")) == (0, 0)
    shown.rig.send("idle")
    assert shown.readings() == pytest.approx(20, abs=2)
    shown.rig.send_hold()
    shown.rig.advance(0.1)
    assert shown.readings() == 0


@pytest.mark.parametrize(("is_asked_for", "wrench"), [(False, WRENCH), (True, None)])
def test_none_is_sent_by_default_or_without_a_reading(
    is_asked_for: bool, wrench: WrenchAtTcp | None
) -> None:
    """Only what was measured, and only where the cell file has it."""
    shown = ShownWrench(wrench, is_asked_for=is_asked_for)
    assert shown.cell.machine.memory.read("fm.wn") == 0
