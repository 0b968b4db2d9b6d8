"""Starts a process that has died again, as containers are: not without end, and into a held cell.

A process starts into rest and only a person arms, so to start one again moves nothing. What dies
again and again is not started any more: it has a cause that another start does not take away.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from launch.started_process import Died, Process, Say

MOST, WITHIN_S = 5, 60.0  # deaths of one process; with the last one it is given up
PAUSE_S = 0.2  # at least, before the first new start; twice as long before each later one
NEXT = "the arm is held: `forcemesh clear`, then `forcemesh arm`"


@dataclass(slots=True)
class Patience:
    """How often and how soon a process is started again. Pure.

    The first pause is no shorter than the deadline of commands: a hub that was back sooner would
    not have been missed, and the arm would not be held.
    """

    pause_s: float = PAUSE_S
    _deaths: dict[str, deque[float]] = field(default_factory=dict)

    def died(self, name: str, now_s: float) -> float | None:
        """Return when to start it again (monotonic time [s]), None when it has died too often."""
        deaths = self._deaths.setdefault(name, deque())
        deaths.append(now_s)
        while deaths[0] <= now_s - WITHIN_S:
            deaths.popleft()
        if len(deaths) >= MOST:
            return None
        return now_s + self.pause_s * 2.0 ** (len(deaths) - 1)

    def deaths(self, name: str) -> int:
        """Return how often it died within the time that counts."""
        return len(self._deaths.get(name, ()))


@dataclass(slots=True)
class Reviver:
    """What becomes of processes of a cell that have died; for the thread that starts them.

    The watching thread tells it of deaths by `fell`.
    """

    start: Callable[[Process, Died], int]  # returns the pid
    hold: Callable[[str], str]
    say: Say
    patience: Patience = field(default_factory=Patience)
    _fallen: deque[Died] = field(default_factory=deque)
    _waiting: list[tuple[float, Died]] = field(default_factory=list)

    def fell(self, died: Died) -> None:
        """Take note of a death."""
        self._fallen.append(died)

    def tend(self, now_s: float) -> list[Died]:
        """Hold the arm for new deaths, start what is due; return what is given up."""
        given_up = []
        fallen = [self._fallen.popleft() for _ in range(len(self._fallen))]
        if fallen:
            self.say("up", self.hold("; ".join(f"died: {died}" for died in fallen)))
        for died in fallen:
            due_s = self.patience.died(died.process.name, now_s)
            if due_s is None:
                self.say("up", given_up_text(died))
                given_up.append(died)
            else:
                self._waiting.append((due_s, died))
        due = [died for due_s, died in self._waiting if due_s <= now_s]
        self._waiting = [(due_s, died) for due_s, died in self._waiting if due_s > now_s]
        for died in due:
            pid = self.start(died.process, died)
            times = self.patience.deaths(died.process.name)
            self.say(
                "up",
                f"{died.process.name} is started again (pid {pid}, death {times}; with "
                f"{MOST} within {WITHIN_S:g} s it is given up); {NEXT}",
            )
        return given_up


def given_up_text(died: Died) -> str:
    """Return what is said of a process that is not started any more."""
    return (
        f"{' and '.join(died.process.roles)} died {MOST} times within {WITHIN_S:g} s and is not "
        f"started again; the arm stays held. Last: {died.how}"
        f"{f', {died.last_words}' if died.last_words else ''}. Take away the cause, end this with "
        "Ctrl-C, and start `forcemesh up` anew"
    )
