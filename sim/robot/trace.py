"""Ground-truth trace: commanded and measured joint angles of each tick, in a file.

Written only if FORCEMESH_TRACE names a file. Each tick is written unbuffered, so the last one
before a kill is kept. Time is the process clock: CLOCK_MONOTONIC, comparable on one host.
"""

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from forcemesh.clock import Clock
from sim.robot.arm import SimArm

VARIABLE = "FORCEMESH_TRACE"
Records = npt.NDArray[np.void]
# tick counts from the start of the arm: a decrease marks a new process.
RECORD = np.dtype([("at_ns", "<i8"), ("tick", "<i8"), ("command", "<f8", 6), ("q", "<f8", 6)])


class ArmTrace:
    """Trace writer: appends a record for each tick of an arm."""

    def __init__(self, arm: SimArm, clock: Clock, path: Path) -> None:
        """Open the file. Raises OSError if it cannot be written."""
        self._arm, self._clock = arm, clock
        self._file = path.open("ab", buffering=0)
        # A record cut by a kill would misalign all later records.
        self._file.truncate(self._file.tell() // RECORD.itemsize * RECORD.itemsize)
        self._record: Records = np.zeros((), RECORD)

    def ticked(self) -> None:
        """Write the last tick: commanded and measured joint angles [rad]."""
        arm = self._arm
        self._record[()] = (self._clock.now_ns(), arm.ticks, arm.q_command, arm.q)
        self._file.write(self._record.tobytes())

    def close(self) -> None:
        """Close the file; without it no data is lost, as writes are unbuffered."""
        self._file.close()


def trace_from_environment(arm: SimArm, clock: Clock) -> ArmTrace | None:
    """Return the trace requested by the environment variable, or None."""
    path = os.environ.get(VARIABLE)
    return ArmTrace(arm, clock, Path(path)) if path else None


def read_trace(path: Path) -> Records:
    """Return the complete records of a trace. Shape (n,), fields of RECORD."""
    whole = path.stat().st_size // RECORD.itemsize if path.exists() else 0
    return np.fromfile(path, RECORD, count=whole) if whole else np.zeros(0, RECORD)
