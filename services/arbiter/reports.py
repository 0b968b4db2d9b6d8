"""Makes what the arbiter says fit into its message, whatever was said to it. Pure."""

from common.messages import Trip

MOST_TRIPS = 4
MOST_LINES = 12
TRIP_BYTES, LINE_BYTES, REASON_BYTES = 400, 120, 400


def clipped(text: str, most_bytes: int) -> str:
    """Return a text cut to a number of bytes, in UTF-8, between characters."""
    return text.encode()[:most_bytes].decode(errors="ignore")


def recent(trips: tuple[Trip, ...]) -> tuple[Trip, ...]:
    """Return the first cause and the newest ones, each short enough to be sent."""
    kept = trips if len(trips) <= MOST_TRIPS else (trips[0], *trips[1 - MOST_TRIPS :])
    return tuple(trip.model_copy(update={"text": clipped(trip.text, TRIP_BYTES)}) for trip in kept)


def lines(texts: list[str]) -> tuple[str, ...]:
    """Return the first of many lines, each short enough to be sent."""
    return tuple(clipped(text, LINE_BYTES) for text in texts[:MOST_LINES])
