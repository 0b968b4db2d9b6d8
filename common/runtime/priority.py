"""Real-time priority (SCHED_FIFO) for the processes of a control loop, if permitted."""

import os
from contextlib import suppress
from pathlib import Path

PRIORITY = 20  # above ordinary processes, below kernel threads and sound servers


def take_realtime_priority(priority: int = PRIORITY) -> bool:
    """Set real-time priority for all threads of this process; return whether it was permitted.

    Call it after start-up: starting takes tenths of a second of CPU time, which at this priority
    would be taken from loops that already run. Threads started later inherit the priority. Without
    the right (CAP_SYS_NICE or an rtprio limit) the process keeps its priority; its health reports
    that.
    """
    try:
        for thread in Path("/proc/self/task").iterdir():
            _set(int(thread.name), os.SCHED_FIFO, priority)
    except (AttributeError, OSError):
        return False
    return True


def give_up_realtime_priority() -> None:
    """Return to ordinary priority before shutdown, for the same reason."""
    with suppress(AttributeError, OSError):
        for thread in Path("/proc/self/task").iterdir():
            _set(int(thread.name), os.SCHED_OTHER, 0)


def has_realtime_priority() -> bool:
    """Return whether this process has real-time priority."""
    try:
        return os.sched_getscheduler(0) == os.SCHED_FIFO
    except (AttributeError, OSError):
        return False


def _set(thread: int, policy: int, priority: int) -> None:
    with suppress(ProcessLookupError):  # it may have ended meanwhile
        os.sched_setscheduler(thread, policy, os.sched_param(priority))
