"""A wire in memory on which one direction can stall, as TCP does on a bad line: late, in order."""

from services.gateway.link import LinkEvents
from sim.controller.network import LockStepLink, MemoryNetwork


class StallingWire(LockStepLink[LinkEvents]):
    """A wire that delays the data of a stalled direction; nothing is lost."""

    newest: "StallingWire"  # the last instance

    def __init__(self, network: MemoryNetwork, port: int, make_events: type[LinkEvents]) -> None:
        """Start without a stall."""
        super().__init__(network, port, make_events)
        self.out_until_ns = self.in_until_ns = 0
        StallingWire.newest = self

    def _flush(self, now_ns: int) -> None:
        if now_ns >= self.out_until_ns:
            super()._flush(now_ns)

    def _receive(self, now_ns: int) -> bytes:
        return super()._receive(now_ns) if now_ns >= self.in_until_ns else b""
