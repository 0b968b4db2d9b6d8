"""Idle witness processes with the scheduling class and period of a control loop.

They have priority over all processes of a cell, so their lateness is caused by the machine. There
is one per processor: a host may withdraw single ones, and the kernel limits real-time tasks to 95 %
of a processor and suspends them for the rest of the second.
`python -m tests.chaos.witness FILE PROCESSOR`
"""

import os
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt

from common.runtime.realtime import PRIORITY, take_realtime_priority
from common.runtime.stop import stop_on_signals
from forcemesh.clock import NS_PER_S
from tests.chaos.common_net import child

PERIOD_S = 0.004
ROW = struct.Struct("<qq")  # wake-up time, lateness [ns]
STALL_S = 0.020

Array = npt.NDArray[np.int64]


class Witness:
    """Reader of the records of all witnesses."""

    def __init__(self, paths: list[Path]) -> None:
        """Read from growing files."""
        self._paths = paths

    def rows(self) -> Array:
        """Return wake-up times and lateness [ns], shape (n, 2)."""
        return np.concatenate([_rows(path) for path in self._paths])

    def worst_s(self, since_ns: int, until_ns: int) -> float:
        """Return the largest lateness between two times [s]."""
        rows = self.rows()
        late = rows[(rows[:, 0] >= since_ns) & (rows[:, 0] - rows[:, 1] <= until_ns), 1]
        return float(late.max()) / NS_PER_S if len(late) else 0.0

    def stalls(self, longer_than_s: float = STALL_S) -> int:
        """Return the number of wake-ups with a larger lateness."""
        return int((self.rows()[:, 1] > longer_than_s * NS_PER_S).sum())

    def stalled_s(self) -> float:
        """Return the total of all stalls, on the processor that stood longest [s]."""
        late = [_rows(path)[:, 1] for path in self._paths]
        return max(float(each[each > STALL_S * NS_PER_S].sum()) / NS_PER_S for each in late)

    def percentile_s(self, percent: float) -> float:
        """Return a percentile of the lateness [s]."""
        return float(np.percentile(self.rows()[:, 1], percent)) / NS_PER_S


def _rows(path: Path) -> Array:
    data = path.read_bytes()
    whole = len(data) // ROW.size * ROW.size
    return np.frombuffer(data[:whole], dtype="<i8").reshape(-1, 2)


@contextmanager
def witness(folder: Path) -> Iterator[Witness]:
    """Run a witness on each processor during the block."""
    with ExitStack() as exits:
        paths = []
        for processor in sorted(os.sched_getaffinity(0)):
            paths.append(folder / f"witness-{processor}.bin")
            paths[-1].write_bytes(b"")
            exits.enter_context(child("tests.chaos.witness", paths[-1], processor))
        yield Witness(paths)


def main() -> None:
    """Sleep periodically and record the lateness of each wake-up."""
    stop = stop_on_signals()
    os.sched_setaffinity(0, {int(sys.argv[2])})
    take_realtime_priority(PRIORITY + 1)
    period_ns = round(PERIOD_S * NS_PER_S)
    out = os.open(sys.argv[1], os.O_WRONLY | os.O_APPEND)
    due_ns = time.monotonic_ns()
    while not stop.is_set():
        due_ns = max(due_ns + period_ns, time.monotonic_ns() - period_ns)
        time.sleep(max(0.0, (due_ns - time.monotonic_ns()) / NS_PER_S))
        now_ns = time.monotonic_ns()
        os.write(out, ROW.pack(now_ns, max(0, now_ns - due_ns)))


if __name__ == "__main__":
    main()
