"""Fault log: each new trip of the arbiter. Pure."""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from forcemesh.messages import ArbiterStatus, Trip

FAULTS_KEPT = 50


class Happened(NamedTuple):
    """Log entry: a trip at the time at which this panel first received it."""

    at: str  # wall clock, as text
    state: str
    trip: Trip


class FaultLog:
    """Bounded log of trips, newest first; kept while the panel runs, shared by all pages."""

    def __init__(self, now_text: Callable[[], str]) -> None:
        """Create an empty log; `now_text` returns the wall clock as text."""
        self._now_text = now_text
        self._happened: deque[Happened] = deque(maxlen=FAULTS_KEPT)
        self._known: set[tuple[str, str]] = set()

    def saw(self, status: ArbiterStatus | None) -> None:
        """Log the trips that were not present before; a trip that recurs is logged again."""
        if status is None:
            return
        present: set[tuple[str, str]] = {(trip.code, status.state) for trip in status.trips}
        for trip in status.trips:
            if (trip.code, status.state) not in self._known:
                self._happened.appendleft(Happened(self._now_text(), status.state, trip))
        self._known = present

    def newest(self) -> tuple[Happened, ...]:
        """Return the entries, newest first."""
        return tuple(self._happened)
