"""Heartbeat file of a process for its container's health check.

The main loop writes one line per second to the file named in the environment: seconds since boot,
as in /proc/uptime, and the present fault. A short shell script reads it at low cost
(common/runtime/alive.sh); if the process hangs or its loop ends, the file becomes stale.
"""

import os
import time
from pathlib import Path

from forcemesh.clock import NS_PER_S

HEARTBEAT_VARIABLE = "FORCEMESH_HEARTBEAT"
HEARTBEAT_PERIOD_S = 1.0
LINE_B = 256  # constant: an update needs no space on a full disk


class Heartbeat:
    """Writer of the heartbeat line; without a file it does nothing."""

    def __init__(self, path: Path | None) -> None:
        """Open the file. The first beat writes it."""
        self._file = None if path is None else os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        self._next_ns = 0
        self._fault = ""

    def beat(self, now_ns: int, fault: str) -> None:
        """Write after a second (monotonic time [ns]), or when the fault has changed."""
        if self._file is None or (now_ns < self._next_ns and fault == self._fault):
            return
        self._next_ns, self._fault = now_ns + round(HEARTBEAT_PERIOD_S * NS_PER_S), fault
        os.pwrite(self._file, line(since_boot_s(), fault), 0)


def line(at_s: int, fault: str) -> bytes:
    """Return a heartbeat line in the file's format."""
    words = " ".join(f"{at_s} {fault}".split()).encode("ascii", "replace")[: LINE_B - 1]
    return words.ljust(LINE_B - 1) + b"\n"


def since_boot_s() -> int:
    """Return the first number of /proc/uptime, whole seconds."""
    return int(time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)))


def heartbeat_of_this_process() -> Heartbeat:
    """Return the heartbeat configured in the environment."""
    named = os.environ.get(HEARTBEAT_VARIABLE)
    return Heartbeat(Path(named) if named else None)
