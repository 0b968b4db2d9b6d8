"""Real-time priority for the processes of a control loop, where the machine grants it."""

import os

PRIORITY = 20  # above everything ordinary, below what the kernel and sound servers use


def take_realtime_priority() -> bool:
    """Let this process go before ordinary ones; tell whether the machine allowed it.

    To be called before any thread is started: threads inherit it. Without the right (CAP_SYS_NICE
    or an rtprio limit) the process runs as it is; its health says so.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):
        return False
    return True


def has_realtime_priority() -> bool:
    """Tell whether this process goes before ordinary ones."""
    try:
        return os.sched_getscheduler(0) == os.SCHED_FIFO
    except (AttributeError, OSError):
        return False
