"""Logs its own lateness: an idle process with the priority and the period of the control loop.

What it is late, the machine is late: then a late control loop is no fault of the cell's.
`python -m chaos.witness FILE`
"""

import sys
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from common.priority import take_realtime_priority

PERIOD_NS = 4_000_000
WORTH_NOTING_NS = 5_000_000
STALL_S = 0.020
Stalls = npt.NDArray[np.int64]  # rows of: due at [ns], woken at [ns]


def main() -> None:
    """Sleep and note until killed."""
    take_realtime_priority()
    with Path(sys.argv[1]).open("ab", buffering=0) as file:
        due_ns = time.monotonic_ns() + PERIOD_NS
        while True:
            time.sleep(max(0, due_ns - time.monotonic_ns()) * 1e-9)
            now_ns = time.monotonic_ns()
            if now_ns - due_ns > WORTH_NOTING_NS:
                file.write(np.array([due_ns, now_ns]).tobytes())
            due_ns = max(due_ns + PERIOD_NS, now_ns)


def read_stalls(path: Path) -> Stalls:
    """Return every lateness that was noted. Shape (n, 2): due at, woken at [ns]."""
    rows = path.stat().st_size // 16 if path.exists() else 0
    return np.fromfile(path, np.int64, count=2 * rows).reshape(-1, 2) if rows else NONE


NONE: Stalls = np.zeros((0, 2), np.int64)


def longest_stall_s(stalls: Stalls, since_ns: int, until_ns: int) -> float:
    """Return how late the witness was at most within a window [s]."""
    inside = stalls[(stalls[:, 1] >= since_ns) & (stalls[:, 0] <= until_ns)]
    return float((inside[:, 1] - inside[:, 0]).max()) * 1e-9 if len(inside) else 0.0


if __name__ == "__main__":
    main()
