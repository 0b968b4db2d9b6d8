"""What has happened: each new reason why the arm was stopped, with what to do about it. Pure."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from forcemesh.faults import FAULTS
from forcemesh.messages import ArbiterStatus, Trip

KEPT = 50


@dataclass(frozen=True, slots=True)
class Happened:
    """One reason, when this panel saw it first."""

    at: str  # wall clock, for people
    state: str
    trip: Trip

    @property
    def remedy(self) -> str:
        """What a person should do."""
        row = FAULTS.get(self.trip.code)
        return "" if row is None else row.remedy


class FaultLog:
    """The newest reasons, newest first; kept while the panel runs, for everybody who looks."""

    def __init__(self, now_text: Callable[[], str]) -> None:
        """Begin empty; `now_text` gives the wall clock."""
        self._now_text = now_text
        self._happened: deque[Happened] = deque(maxlen=KEPT)
        self._known: set[tuple[str, str]] = set()

    def saw(self, status: ArbiterStatus | None) -> None:
        """Note what is new: a reason counts again once it was gone."""
        if status is None:
            return
        present: set[tuple[str, str]] = {(trip.code, status.state) for trip in status.trips}
        for trip in status.trips:
            if (trip.code, status.state) not in self._known:
                self._happened.appendleft(Happened(self._now_text(), status.state, trip))
        self._known = present

    def newest(self) -> tuple[Happened, ...]:
        """Return all that is kept, newest first."""
        return tuple(self._happened)
