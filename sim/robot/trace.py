"""What the simulated arm truly did, tick by tick, in a file: for whoever judges from outside.

Written only where FORCEMESH_TRACE names a file. Each tick goes out at once, so that the last one
before a kill is there. Time is the clock's of the process: CLOCK_MONOTONIC, comparable on one host.
"""

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from forcemesh.clock import Clock
from sim.robot.arm import SimArm

VARIABLE = "FORCEMESH_TRACE"
Records = npt.NDArray[np.void]
# tick counts from the start of the arm: a smaller one than before begins another process.
RECORD = np.dtype([("at_ns", "<i8"), ("tick", "<i8"), ("command", "<f8", 6), ("q", "<f8", 6)])


class ArmTrace:
    """Appends a record for each tick of an arm."""

    def __init__(self, arm: SimArm, clock: Clock, path: Path) -> None:
        """Open the file. Raises OSError where it cannot be written."""
        self._arm, self._clock = arm, clock
        self._file = path.open("ab", buffering=0)
        # A process that was killed in the middle of a record would shift all that follow.
        self._file.truncate(self._file.tell() // RECORD.itemsize * RECORD.itemsize)
        self._record: Records = np.zeros((), RECORD)

    def ticked(self) -> None:
        """Note the tick that was just made: commanded and measured joint angles [rad]."""
        arm = self._arm
        self._record[()] = (self._clock.now_ns(), arm.ticks, arm.q_command, arm.q)
        self._file.write(self._record.tobytes())

    def close(self) -> None:
        """Close the file; a process that just ends loses nothing either."""
        self._file.close()


def wanted_trace(arm: SimArm, clock: Clock) -> ArmTrace | None:
    """Return the trace that the environment asks for, if it does."""
    path = os.environ.get(VARIABLE)
    return ArmTrace(arm, clock, Path(path)) if path else None


def read_trace(path: Path) -> Records:
    """Return the whole records of a trace so far. Shape (n,), fields of RECORD."""
    whole = path.stat().st_size // RECORD.itemsize if path.exists() else 0
    return np.fromfile(path, RECORD, count=whole) if whole else np.zeros(0, RECORD)
