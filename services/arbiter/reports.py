"""Truncation of the arbiter's status texts to the size of their message. Pure."""

from forcemesh.faults import FAULTS, clipped
from forcemesh.messages import MAY_MOVE, ArbiterState, Purpose, Trip
from services.arbiter.states import CLEARS, TABLE

MOST_TRIPS = 4
MOST_LINES = 12
LINE_BYTES = 120
MORE = " …"
ALONE: dict[Purpose, str] = {
    "jog": "armed for jog alone; for force feedback hold, then arm",
    "back_off": "the arm backs off by itself, then holds",
}


def recent(trips: tuple[Trip, ...]) -> tuple[Trip, ...]:
    """Return the first cause and the latest ones."""
    return trips if len(trips) <= MOST_TRIPS else (trips[0], *trips[1 - MOST_TRIPS :])


def lines(texts: list[str]) -> tuple[str, ...]:
    """Return the first lines, each cut to its largest length."""
    return tuple(_short(text) for text in texts[:MOST_LINES])


def what_next(state: ArbiterState, not_ready: list[Trip], armed_for: Purpose = "all") -> str:
    """Return the next step for a person: the remedy if arming would be refused."""
    if state in MAY_MOVE and armed_for in ALONE:
        return ALONE[armed_for]
    if not_ready and "arm" in TABLE[state]:
        return f"{FAULTS[not_ready[0].code].remedy}; then arm"
    return CLEARS[state]


def _short(text: str) -> str:
    """Cut between words, with a mark at the cut."""
    if len(text.encode()) <= LINE_BYTES:
        return text
    beginning = clipped(text, LINE_BYTES - len(MORE.encode()))
    return (beginning.rpartition(" ")[0] or beginning) + MORE
