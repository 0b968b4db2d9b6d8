"""The emulator keeps up with real time."""

from common.bus.memory_bus import MemoryTransport
from common.config.load import load_cell
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from sim.controller.network import MemoryNetwork
from sim.controller.service import ControllerSensor
from tests.contract.rig import DEMO_CELL


def test_time_before_it_began_is_neither_made_up_for_nor_lost() -> None:
    """Loading takes as long as it takes; then every millisecond is one tick of the arm."""
    cell, clock = load_cell(DEMO_CELL), ManualClock()
    bus = Bus("sensor", cell.cell, MemoryTransport(), cell, clock)
    service = ControllerSensor(bus, cell, MemoryNetwork())
    clock.sleep_s(3.0)
    service.begin(clock.now_ns())
    service.step(clock.now_ns())
    assert service.arm.ticks == 0
    for _ in range(7):
        clock.sleep_s(0.001)
        service.step(clock.now_ns())
    assert service.arm.ticks == 7
    assert service.counters()["ms_lost"] == 0
    clock.sleep_s(0.060)
    service.step(clock.now_ns())
    assert service.arm.ticks == 57
    assert service.counters()["ms_lost"] == 10
