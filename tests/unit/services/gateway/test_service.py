"""The gateway as a process: its configuration, its reports without a controller, its end."""

import pytest

from common.bus.memory_bus import MemoryTransport
from controller.packet_table import ID_COUNT, ID_FIRST
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.errors import ConfigError
from services.gateway.service import Gateway
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
