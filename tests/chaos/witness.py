"""The idle witnesses: scheduling class and period of a control loop, and nothing to do.

What they oversleep is the machine's doing, not ours: they go before every process of a cell. One
for each processor: a host takes single ones away, and the kernel lets real time have 95 % of a
processor and stops whatever runs on that one for the rest of the second.
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

from common.runtime.priority import PRIORITY, take_realtime_priority
from common.runtime.service import stop_on_signals
from forcemesh.clock import NS_PER_S
from tests.chaos.common_net import child

PERIOD_S = 0.004
ROW = struct.Struct("<qq")  # when it woke, how late that was [ns]
STALL_S = 0.020

Array = npt.NDArray[np.int64]


class Witness:
    """What the witnesses wrote so far."""

    def __init__(self, paths: list[Path]) -> None:
        """Read from files that grow."""
        self._paths = paths

    def rows(self) -> Array:
        """Return moments and lateness [ns], shape (n, 2)."""
        return np.concatenate([_rows(path) for path in self._paths])

    def worst_s(self, since_ns: int, until_ns: int) -> float:
        """Return how late it was at worst between two moments [s]."""
        rows = self.rows()
        late = rows[(rows[:, 0] >= since_ns) & (rows[:, 0] - rows[:, 1] <= until_ns), 1]
        return float(late.max()) / NS_PER_S if len(late) else 0.0

    def stalls(self, longer_than_s: float = STALL_S) -> int:
        """Return how often it was later than that."""
        return int((self.rows()[:, 1] > longer_than_s * NS_PER_S).sum())

    def percentile_s(self, percent: float) -> float:
        """Return a percentile of its lateness [s]."""
        return float(np.percentile(self.rows()[:, 1], percent)) / NS_PER_S


def _rows(path: Path) -> Array:
    data = path.read_bytes()
    whole = len(data) // ROW.size * ROW.size
    return np.frombuffer(data[:whole], dtype="<i8").reshape(-1, 2)


@contextmanager
def witness(folder: Path) -> Iterator[Witness]:
    """Let a witness run on each processor beside the block."""
    with ExitStack() as exits:
        paths = []
        for processor in sorted(os.sched_getaffinity(0)):
            paths.append(folder / f"witness-{processor}.bin")
            paths[-1].write_bytes(b"")
            exits.enter_context(child("tests.chaos.witness", paths[-1], processor))
        yield Witness(paths)


def main() -> None:
    """Sleep, wake, write down how late."""
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
