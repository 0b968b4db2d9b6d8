"""A wire in memory on which one direction can stall, as TCP does on a bad line: late, in order."""

from services.gateway.link import News
from sim.controller.network import MemoryNetwork
from sim.controller.wire import LockStepLink


class StallingWire(LockStepLink[News]):
    """What is sent, or what comes in, waits while its direction is stalled; nothing is lost."""

    newest: "StallingWire"  # the one that was made last

    def __init__(self, network: MemoryNetwork, port: int, make_news: type[News]) -> None:
        """Stall nothing yet."""
        super().__init__(network, port, make_news)
        self.out_until_ns = self.in_until_ns = 0
        StallingWire.newest = self

    def _flush(self, now_ns: int) -> None:
        if now_ns >= self.out_until_ns:
            super()._flush(now_ns)

    def _receive(self, now_ns: int) -> bytes:
        return super()._receive(now_ns) if now_ns >= self.in_until_ns else b""
