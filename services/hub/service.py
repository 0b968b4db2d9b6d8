"""Hub service: health of the Zenoh router, which works in its own threads."""

import socket
import struct
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Protocol, runtime_checkable

from common.config.cell import CellConfig
from common.config.info import cell_info
from forcemesh.bus import Bus
from forcemesh.cell_info import info_server
from forcemesh.schema import describer
from services.hub.refusals import Refusals

STEPS_PER_REPORT = 5
# Links of one certificate. Further subscriptions of one link cost the hub nothing, each further
# link that subscribes to everything does (docs/results/subscriptions.json).
MOST_LINKS = 4
OPEN_FILES = Path("/proc/self/fd")
OFF = struct.pack("ii", 0, 0)  # struct linger


@runtime_checkable
class Linked(Protocol):
    """Transport that lists its connected clients."""

    def links_by_name(self) -> Counter[str]:
        """Return the number of open links of each certificate."""


class Hub:
    """Service around Zenoh's router: healthy while this loop runs."""

    def __init__(self, bus: Bus, cell: CellConfig, refusals: Refusals | None = None) -> None:
        """Step a little more often than the health is published."""
        self.period_s = 1.0 / (STEPS_PER_REPORT * cell.rates.health_hz)
        self.trigger = None
        self._transport = bus.transport
        self._refusals = refusals or Refusals()
        self._describer = describer(bus)
        self._info = info_server(bus.transport, cell_info(cell))

    @property
    def fault(self) -> str:
        """Certificates with more open links than MOST_LINKS, empty when there are none."""
        if not isinstance(self._transport, Linked):
            return ""
        links = sorted(self._transport.links_by_name().items())
        many = [f"{name} has {count} links" for name, count in links if count > MOST_LINKS]
        return f"{', '.join(many)}; more than {MOST_LINKS} slow the hub down" if many else ""

    def step(self, now_ns: int) -> None:
        """Report refusals, answer queries for the message schema, keep links from lingering."""
        linger_on_none()
        self._refusals.step(now_ns)
        self._describer.step()
        self._info.step()

    def counters(self) -> dict[str, int]:
        """Return the number of refusals by cause; Zenoh keeps the other counters."""
        return {f"refused_{code}": times for code, times in self._refusals.counts.items()}


def linger_on_none() -> None:
    """Let the kernel close every socket of this process in the background.

    Zenoh lets each one linger for 10 s, fixed when it is built. A thread of the hub then stands
    still that long when it closes the link of a client that is frozen and has data to come.
    """
    for file in OPEN_FILES.glob("*"):
        with suppress(OSError):  # no socket, or closed since
            each = socket.socket(fileno=int(file.name))
            try:
                each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, OFF)
            finally:
                each.detach()  # it stays Zenoh's
