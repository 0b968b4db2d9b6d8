"""Hub service: health of the Zenoh router, which works in its own threads."""

from collections import Counter
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
        """Report refusals and answer queries for the message schema."""
        self._refusals.step(now_ns)
        self._describer.step()
        self._info.step()

    def counters(self) -> dict[str, int]:
        """Return the number of refusals by cause; Zenoh keeps the other counters."""
        return {f"refused_{code}": times for code, times in self._refusals.counts.items()}
