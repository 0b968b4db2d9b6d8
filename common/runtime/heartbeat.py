"""The heartbeat of a process for its container's health check: a file that costs nothing to judge.

The loop that does the work writes one line a second into the file that the environment names:
seconds since the machine's start, as in /proc/uptime, and the fault of the moment. A few lines of
shell read it (common/runtime/alive.sh); a process that hangs, or whose loop has ended, goes stale.
"""

import os
import time
from pathlib import Path

from forcemesh.clock import NS_PER_S

HEARTBEAT_VARIABLE = "FORCEMESH_HEARTBEAT"
PERIOD_S = 1.0
LINE_B = 256  # always as long: an update needs no room on a disk that is full


class Heartbeat:
    """Writes the line; without a file it does nothing."""

    def __init__(self, path: Path | None) -> None:
        """Open the file. The first beat writes it."""
        self._file = None if path is None else os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        self._next_ns = 0
        self._fault = ""

    def beat(self, now_ns: int, fault: str) -> None:
        """Write when a second has gone by (monotonic time [ns]), or the fault is another one."""
        if self._file is None or (now_ns < self._next_ns and fault == self._fault):
            return
        self._next_ns, self._fault = now_ns + round(PERIOD_S * NS_PER_S), fault
        os.pwrite(self._file, line(since_boot_s(), fault), 0)


def line(at_s: int, fault: str) -> bytes:
    """Return a heartbeat as the file holds it."""
    words = " ".join(f"{at_s} {fault}".split()).encode("ascii", "replace")[: LINE_B - 1]
    return words.ljust(LINE_B - 1) + b"\n"


def since_boot_s() -> int:
    """Return the first number of /proc/uptime, whole seconds."""
    return int(time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)))


def heartbeat_of_this_process() -> Heartbeat:
    """Return the heartbeat that the environment asks for."""
    named = os.environ.get(HEARTBEAT_VARIABLE)
    return Heartbeat(Path(named) if named else None)
