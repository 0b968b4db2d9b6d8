"""Restart of processes that have died: with back-off, a limit, and the arm held.

A process starts at rest and only a person arms, so a restart causes no motion. A process that dies
repeatedly is not restarted any more: its cause persists.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from launch.started_process import ProcessExit, ProcessSpec, WriteLine

MOST, WITHIN_S = 5, 60.0  # deaths of one process until it is given up
RESTART_PAUSE_S = 0.2  # shortest back-off before the first restart; doubled for each later one
NEXT = "the arm is held: `forcemesh clear`, then `forcemesh arm`"


@dataclass(slots=True)
class RestartPolicy:
    """Restart policy: exponential back-off and a limit of deaths within a window. Pure.

    The first pause is no shorter than the deadline of commands: with a shorter one the loss of a
    hub would go undetected, and the arm would not hold.
    """

    pause_s: float = RESTART_PAUSE_S
    _deaths: dict[str, deque[float]] = field(default_factory=dict)

    def died(self, name: str, now_s: float) -> float | None:
        """Return when to restart it (monotonic time [s]), None when it has died too often."""
        deaths = self._deaths.setdefault(name, deque())
        deaths.append(now_s)
        while deaths[0] <= now_s - WITHIN_S:
            deaths.popleft()
        if len(deaths) >= MOST:
            return None
        return now_s + self.pause_s * 2.0 ** (len(deaths) - 1)

    def deaths(self, name: str) -> int:
        """Return how often it died within the window."""
        return len(self._deaths.get(name, ()))


@dataclass(slots=True)
class Restarter:
    """Restarts of the processes of a cell; for the thread that starts them.

    The watching thread reports deaths with `fell`.
    """

    start: Callable[[ProcessSpec, ProcessExit], int]  # returns the pid
    hold: Callable[[str], str]
    say: WriteLine
    patience: RestartPolicy = field(default_factory=RestartPolicy)
    _fallen: deque[ProcessExit] = field(default_factory=deque)
    _waiting: list[tuple[float, ProcessExit]] = field(default_factory=list)

    def fell(self, died: ProcessExit) -> None:
        """Queue a death."""
        self._fallen.append(died)

    def tend(self, now_s: float) -> list[ProcessExit]:
        """Hold the arm for new deaths, restart what is due; return what is given up."""
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
                f"{died.process.name} restarted (pid {pid}, death {times}; after "
                f"{MOST} within {WITHIN_S:g} s it is given up); {NEXT}",
            )
        return given_up


def given_up_text(died: ProcessExit) -> str:
    """Return the message for a process that is given up."""
    return (
        f"{' and '.join(died.process.roles)} died {MOST} times within {WITHIN_S:g} s and is not "
        f"restarted; the arm stays held. Last: {died.how}"
        f"{f', {died.last_words}' if died.last_words else ''}. Remove the cause, stop this with "
        "Ctrl-C, and restart `forcemesh up`"
    )
