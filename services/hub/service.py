"""What the hub says of itself: it is alive as long as this loop runs. Zenoh does the rest."""

from common.cell import Cell
from common.describe import Describer
from common.endpoints import Bus
from services.hub.refusals import Refusals

STEPS_PER_REPORT = 5


class Hub:
    """What Zenoh does by itself, as a service: alive as long as this loop runs."""

    def __init__(self, bus: Bus, cell: Cell, refusals: Refusals | None = None) -> None:
        """Step a little more often than the health is published."""
        self.period_s = 1.0 / (STEPS_PER_REPORT * cell.rates.health_hz)
        self.trigger = None
        self.fault = ""
        self._refusals = refusals or Refusals()
        self._describer = Describer(bus)

    def step(self, now_ns: int) -> None:
        """Tell what was refused and what is said here: the router works in its own threads."""
        self._refusals.step(now_ns)
        self._describer.step()

    def counters(self) -> dict[str, int]:
        """Return what was refused, by cause; Zenoh counts the rest for itself."""
        return {f"refused_{code}": times for code, times in self._refusals.counts.items()}
