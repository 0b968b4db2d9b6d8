"""A whole cell around the gateway: fake controller, gateway, stand-in for the arbiter."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from common.clock import MonotonicClock
from common.packet_table import Com
from services.gateway.service import Gateway
from tests.contract.rig import Rig, gateway_cell
from tests.fakes.controller import FakeController


class GatewayCell:
    """A controller, its gateway, and the stand-in for the arbiter."""

    def __init__(self, stack: ExitStack, rate_hz: float = 100.0, **overrides: object) -> None:
        self.controller = stack.enter_context(FakeController(rate_hz=rate_hz))
        cell = gateway_cell(self.controller.port, **overrides)
        self.rig = Rig(cell, MonotonicClock(), Gateway)
        assert isinstance(self.rig.service, Gateway)
        stack.callback(self.rig.service.close)

    def coms(self) -> list[int]:
        """Commands that the controller got, in their order, without heartbeats."""
        return [p.com for p in self.controller.of(*Com) if p.com != Com.HEARTBEAT]

    def reports_pass(self) -> None:
        """Let a few reports of the controller come through."""
        self.rig.states.clear()
        self.rig.until(lambda: len(self.rig.states) > 5)


@contextmanager
def a_cell(**settings: object) -> Iterator[GatewayCell]:
    """A cell with other settings."""
    with ExitStack() as stack:
        yield GatewayCell(stack, **settings)  # type: ignore[arg-type]
