"""Account of the processor time of a process, and of its loop: why a step was late.

Linux counts for every thread the time that it ran and the time that it could have run but waited
for a processor (`/proc/thread-self/schedstat`, Documentation/scheduler/sched-stats.rst).
"""

import time
from contextlib import suppress
from pathlib import Path

from common.runtime.realtime import has_realtime_priority
from forcemesh.clock import NS_PER_S

SCHEDSTAT = Path("/proc/thread-self/schedstat")  # ran [ns], waited [ns], times
OWN_WORK = "its own step took that long"
STOPPED = "it was stopped, or waited for memory or a disk"
OTHERS = "it waited for a processor: it has no real-time priority, and other processes ran"
REALTIME = (
    "it waited for a processor although it has real-time priority: other real-time processes ran, "
    "or the kernel's limit for them (sched_rt_runtime_us) was reached"
)


class ProcessorAccount:
    """Processor time of this process; of the calling thread, the loop, also its waiting time."""

    def __init__(self) -> None:
        """Begin with nothing used."""
        self._process_ns, self._since_ns = time.process_time_ns(), time.monotonic_ns()
        self._ran_ns = [time.thread_time_ns()] * 2  # of the loop, after the last two steps
        self._waited_ns = waited_ns()

    def fraction(self) -> float:
        """Return the processor time of all threads since the last call, in cores."""
        process_ns, since_ns = self._process_ns, self._since_ns
        self._process_ns, self._since_ns = time.process_time_ns(), time.monotonic_ns()
        self._waited_ns = waited_ns()
        return (self._process_ns - process_ns) / max(self._since_ns - since_ns, 1)

    def stepped(self) -> None:
        """Note the end of a step."""
        self._ran_ns = [self._ran_ns[1], time.thread_time_ns()]

    def cause_of(self, gap_s: float) -> str:
        """Return why the last step began so long [s] after the one before."""
        ran_s = (self._ran_ns[1] - self._ran_ns[0]) / NS_PER_S
        if ran_s > 0.5 * gap_s:
            return OWN_WORK
        waited_s = (waited_ns() - self._waited_ns) / NS_PER_S
        if waited_s < 0.5 * (gap_s - ran_s):
            return STOPPED
        return REALTIME if has_realtime_priority() else OTHERS


def waited_ns() -> int:
    """Return how long the calling thread has waited for a processor [ns]; 0 where unknown."""
    with suppress(OSError, IndexError, ValueError):
        return int(SCHEDSTAT.read_text("ascii").split()[1])
    return 0
