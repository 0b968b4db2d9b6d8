"""Real-time priority for the processes of a control loop, where the machine grants it."""

import os
from contextlib import suppress
from pathlib import Path

PRIORITY = 20  # above everything ordinary, below what the kernel and sound servers use


def take_realtime_priority(priority: int = PRIORITY) -> bool:
    """Let all threads of this process go before ordinary ones; tell whether the machine allowed it.

    To be called when the process is ready to work, not before: starting up takes whole tenths of a
    second of a core, and with this priority it would take them from the loops that run already.
    Threads that are started later inherit it. Without the right (CAP_SYS_NICE or an rtprio limit)
    the process runs as it is; its health says so.
    """
    try:
        for thread in Path("/proc/self/task").iterdir():
            _set(int(thread.name), os.SCHED_FIFO, priority)
    except (AttributeError, OSError):
        return False
    return True


def give_up_realtime_priority() -> None:
    """Let this process end as an ordinary one, for the same reason."""
    with suppress(AttributeError, OSError):
        for thread in Path("/proc/self/task").iterdir():
            _set(int(thread.name), os.SCHED_OTHER, 0)


def has_realtime_priority() -> bool:
    """Tell whether this process goes before ordinary ones."""
    try:
        return os.sched_getscheduler(0) == os.SCHED_FIFO
    except (AttributeError, OSError):
        return False


def _set(thread: int, policy: int, priority: int) -> None:
    with suppress(ProcessLookupError):  # it may have ended meanwhile
        os.sched_setscheduler(thread, policy, os.sched_param(priority))
