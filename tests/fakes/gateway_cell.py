"""A cell of the gateway: fake controller, gateway, substitute of the arbiter."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from controller.packet_table import Com
from forcemesh.clock import ManualClock, MonotonicClock
from services.gateway.service import Gateway
from sim.controller.network import MemoryNetwork
from tests.contract.rig import Rig, gateway_cell
from tests.contract.robots import faked
from tests.fakes.controller import PORT, FakeController


class GatewayCell:
    """A controller, its gateway, and the substitute of the arbiter."""

    def __init__(self, controller: FakeController, rig: Rig) -> None:
        self.controller, self.rig = controller, rig

    def coms(self) -> list[int]:
        """Commands that the controller has received, in order, without heartbeats."""
        return [p.com for p in self.controller.of(*Com) if p.com != Com.HEARTBEAT]

    def reports_pass(self) -> None:
        """Advance by a few reports of the controller."""
        self.rig.states.clear()
        self.rig.until(lambda: len(self.rig.states) > 5)


def a_cell(rate_hz: float = 100.0, **overrides: object) -> GatewayCell:
    """Return a cell on a virtual clock, its wire in memory."""
    network = MemoryNetwork()
    controller = FakeController(network, rate_hz=rate_hz)
    cell = gateway_cell(PORT, **overrides)
    return GatewayCell(controller, Rig(cell, ManualClock(), faked(controller, network)))


@contextmanager
def a_cell_on_sockets(rate_hz: float = 100.0, **overrides: object) -> Iterator[GatewayCell]:
    """A cell on a real socket, in real time."""
    with ExitStack() as stack:
        controller = stack.enter_context(FakeController(rate_hz=rate_hz))
        rig = Rig(gateway_cell(controller.port, **overrides), MonotonicClock(), Gateway)
        assert isinstance(rig.service, Gateway)
        stack.callback(rig.service.close)
        yield GatewayCell(controller, rig)
