"""What the hub says of itself: it is alive as long as this loop runs. Zenoh does the rest."""

from common.cell import Cell
from common.endpoints import Bus

STEPS_PER_REPORT = 5


class Hub:
    """What Zenoh does by itself, as a service: alive as long as this loop runs."""

    def __init__(self, _bus: Bus, cell: Cell) -> None:
        """Step a little more often than the health is published."""
        self.period_s = 1.0 / (STEPS_PER_REPORT * cell.rates.health_hz)
        self.trigger = None
        self.fault = ""

    def step(self, now_ns: int) -> None:
        """Nothing: the router works in its own threads."""

    def counters(self) -> dict[str, int]:
        """Return nothing: Zenoh counts for itself."""
        return {}
