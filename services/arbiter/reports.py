"""Makes what the arbiter says fit into its message, whatever was said to it. Pure."""

from common.faults import clipped
from common.messages import Trip

MOST_TRIPS = 4
MOST_LINES = 12
LINE_BYTES = 120


def recent(trips: tuple[Trip, ...]) -> tuple[Trip, ...]:
    """Return the first cause and the newest ones."""
    return trips if len(trips) <= MOST_TRIPS else (trips[0], *trips[1 - MOST_TRIPS :])


def lines(texts: list[str]) -> tuple[str, ...]:
    """Return the first of many lines, each short enough to be sent."""
    return tuple(clipped(text, LINE_BYTES) for text in texts[:MOST_LINES])
