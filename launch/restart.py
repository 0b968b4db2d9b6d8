"""Restart of processes that have died: with back-off, a limit, and the arm held.

A process starts at rest and only a person arms, so a restart causes no motion. A process that dies
repeatedly is not restarted any more: its cause persists.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from launch.started_process import ProcessExit, WriteLine

DEATH_LIMIT, DEATH_WINDOW_S = 5, 60.0  # deaths of one process until it is given up
RESTART_PAUSE_S = 0.2  # shortest back-off before the first restart; doubled for each later one
CANNOT_RUN_CODE = 2  # exit code of a process that has reported why it cannot run
REARM_STEP = "the arm is held: `forcemesh clear`, then `forcemesh arm`"


@dataclass(slots=True)
class Restarter:
    """Restarts of the processes of a cell, with exponential back-off and a limit within a window.

    The first pause is no shorter than the deadline of commands: with a shorter one the loss of a
    hub would go undetected, and the arm would not hold.
    """

    start: Callable[[ProcessExit], int]  # in place of one that died; returns the pid
    hold: Callable[[str], str]
    write_line: WriteLine
    pause_s: float = RESTART_PAUSE_S
    _deaths: dict[str, deque[float]] = field(default_factory=dict)
    _waiting: list[tuple[float, ProcessExit]] = field(default_factory=list)

    def restart_time_s(self, name: str, now_s: float) -> float | None:
        """Count a death; return when to restart [s], None when it has died too often."""
        deaths = self._deaths.setdefault(name, deque())
        deaths.append(now_s)
        while deaths[0] <= now_s - DEATH_WINDOW_S:
            deaths.popleft()
        if len(deaths) >= DEATH_LIMIT:
            return None
        return now_s + self.pause_s * 2.0 ** (len(deaths) - 1)

    def update(self, now_s: float, new_exits: Sequence[ProcessExit] = ()) -> list[ProcessExit]:
        """Hold the arm for new deaths, restart what is due; return what is given up.

        The cell continues without a helper.
        """
        given_up = []
        if of_the_cell := [died for died in new_exits if not died.process.is_helper]:
            self.write_line("up", self.hold("; ".join(f"died: {died}" for died in of_the_cell)))
        for died in new_exits:
            due_s = self.restart_time_s(died.process.name, now_s)
            if died.process.is_helper and (due_s is None or died.code == CANNOT_RUN_CODE):
                text = f"{died.process.name} is not running: {died.cause}"
                self.write_line("up", f"{text}; the cell continues without it")
            elif due_s is None:
                self.write_line("up", given_up_text(died))
                given_up.append(died)
            else:
                self._waiting.append((due_s, died))
        due = [died for due_s, died in self._waiting if due_s <= now_s]
        self._waiting = [(due_s, died) for due_s, died in self._waiting if due_s > now_s]
        for died in due:
            pid = self.start(died)
            times = len(self._deaths[died.process.name])
            self.write_line(
                "up",
                f"{' and '.join(died.process.roles)} restarted (pid {pid}, death {times}; after "
                f"{DEATH_LIMIT} within {DEATH_WINDOW_S:g} s it is given up)"
                + ("" if died.process.is_helper else f"; {REARM_STEP}"),
            )
        return given_up


def given_up_text(died: ProcessExit) -> str:
    """Return the message for a process that is given up."""
    return (
        f"{' and '.join(died.process.roles)} died {DEATH_LIMIT} times within "
        f"{DEATH_WINDOW_S:g} s and is not restarted; the arm stays held. Last: {died.cause}"
        f"{f', {died.last_output}' if died.last_output else ''}. Remove the cause, stop this with "
        "Ctrl-C, and restart `forcemesh up`"
    )
