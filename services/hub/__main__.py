"""Hub: the Zenoh router on which every process of a cell hangs. Its only own word is its health."""

from common.bus import open_hub
from common.cell import Cell
from common.clock import MonotonicClock
from common.priority import take_realtime_priority
from common.service import (
    Runner,
    cell_from_arguments,
    exit_on_error,
    reporter_of,
    stop_on_signals,
)

STEPS_PER_REPORT = 5


class UnhurriedClock(MonotonicClock):
    """The host's clock for a process that has nothing to do in time: it leaves the CPU alone."""

    def sleep_s(self, duration_s: float) -> None:
        """Sleep at least 5 ms."""
        super().sleep_s(max(duration_s, 0.005))


class Hub:
    """What Zenoh does by itself, as a service: alive as long as this loop runs."""

    def __init__(self, cell: Cell) -> None:
        """Step a little more often than the health is published."""
        self.period_s = 1.0 / (STEPS_PER_REPORT * cell.rates.health_hz)
        self.trigger = None
        self.fault = ""

    def step(self, now_ns: int) -> None:
        """Nothing: the router works in its own threads."""

    def counters(self) -> dict[str, int]:
        """Return nothing: Zenoh counts for itself."""
        return {}


def main() -> None:
    """Run until SIGTERM or SIGINT; end with exit code 2 when the endpoint is taken."""
    cell = cell_from_arguments("hub")
    stop = stop_on_signals()
    take_realtime_priority()
    with exit_on_error("hub"), open_hub(cell, clock=UnhurriedClock()) as bus:
        Runner(Hub(cell), [reporter_of(bus, cell)], bus.clock).run(stop)


if __name__ == "__main__":
    main()
