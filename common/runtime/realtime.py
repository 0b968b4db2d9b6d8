"""Real time for the processes of a control loop: priority, locked memory, processor account.

A page fault to swap costs a control loop milliseconds. Why a step was late is known from the time
that its thread ran, and from the time that it could have run but waited for a processor: Linux
counts both (`/proc/thread-self/schedstat`, Documentation/scheduler/sched-stats.rst).
"""

import ctypes
import gc
import os
import platform
import resource
import struct
import time
from contextlib import suppress
from pathlib import Path

from forcemesh.clock import NS_PER_S
from forcemesh.errors import ConfigError

PRIORITY = 20  # above ordinary processes, below kernel threads and sound servers
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4  # <sys/mman.h>
CAP_IPC_LOCK = 14  # <linux/capability.h>
SLICE_NS = 500_000  # about a step; by measurement (docs/decisions.md)
SCHED_SETATTR = {
    "x86_64": 314,
    "aarch64": 274,
}  # <asm/unistd.h>
SCHED_ATTR = struct.Struct("=IIQiIQQQ")  # <linux/sched/types.h>: slice in the field sched_runtime
SCHED_FLAG_KEEP_POLICY = 0x08  # <linux/sched.h>
SCHEDSTAT = Path("/proc/thread-self/schedstat")  # ran [ns], waited [ns], times
OWN_WORK = "its own step took that long"
STOPPED = "it was stopped, or waited for memory or a disk"
OTHERS = "it waited for a processor: it has no real-time priority, and other processes ran"
REALTIME = (
    "it waited for a processor although it has real-time priority: other real-time processes ran, "
    "or the kernel's limit for them (sched_rt_runtime_us) was reached"
)

_locked = False


def prepare_realtime() -> None:
    """Prepare for real time after start-up: collect garbage, lock memory, set the priority.

    Objects from start-up stay in memory; a garbage collection over all of them takes tens of
    milliseconds.
    """
    gc.collect()
    gc.freeze()
    lock_memory()
    take_realtime_priority()


def take_realtime_priority(priority: int = PRIORITY) -> bool:
    """Set real-time priority for all threads of this process; return whether it was permitted.

    Call it after start-up: starting takes tenths of a second of CPU time, which at this priority
    would be taken from loops that already run. Threads started later inherit the priority. Without
    the right (CAP_SYS_NICE or an rtprio limit) the process keeps its priority, which its health
    reports, and requests short time slices.
    """
    try:
        _set_all_threads(os.SCHED_FIFO, priority)
    except (AttributeError, OSError):
        request_short_slices(os.getpid())
        return False
    return True


def request_short_slices(pid: int) -> None:
    """Request short time slices for all threads of a process; it needs no right.

    From Linux 6.12 on a woken thread goes before one with longer slices, while it has used less
    than its share of the processor (Documentation/scheduler/sched-eevdf.rst). Others ignore it.
    """
    number = SCHED_SETATTR.get(platform.machine())
    for thread in _threads(pid) if number else ():
        with suppress(ProcessLookupError):  # the thread has ended
            nice = os.getpriority(os.PRIO_PROCESS, thread)
            attributes = SCHED_ATTR.pack(
                SCHED_ATTR.size, 0, SCHED_FLAG_KEEP_POLICY, nice, 0, SLICE_NS, 0, 0
            )
            ctypes.CDLL(None).syscall(number, thread, attributes, 0)


def bind_to_cores(cores: tuple[int, ...]) -> None:
    """Bind this process, and what it starts from now on, to processor cores.

    Raises:
        ConfigError: A core does not exist, or this process may not use it.
    """
    existing, bound = f"this PC has {os.cpu_count()}, from 0 on", set[int]()
    with suppress(AttributeError, OSError):
        os.sched_setaffinity(0, cores)
        bound = os.sched_getaffinity(0)  # the kernel leaves out those that it does not have
    if missing := sorted(set(cores) - bound):
        text = f"core {', '.join(map(str, missing))} cannot be used: {existing}"
        raise ConfigError("cores", [text])


def give_up_realtime_priority() -> None:
    """Return to ordinary priority before shutdown, for the same reason."""
    with suppress(AttributeError, OSError):
        _set_all_threads(os.SCHED_OTHER, 0)


def has_realtime_priority() -> bool:
    """Return whether this process has real-time priority."""
    try:
        return os.sched_getscheduler(0) == os.SCHED_FIFO
    except (AttributeError, OSError):
        return False


def lock_memory() -> bool:
    """Lock this process's pages, future ones at first use; return whether it was allowed.

    Only without a limit (`ulimit -l unlimited`, or CAP_IPC_LOCK): with a limit the kernel would
    refuse memory later, at run time.
    """
    global _locked  # noqa: PLW0603 - a property of the process
    if not _may_lock_without_limit():
        return False
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        _locked = bool(libc.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0)
    except (OSError, AttributeError):  # not Linux
        return False
    return _locked


def is_memory_locked() -> bool:
    """Return whether `lock_memory` succeeded in this process."""
    return _locked


def _set_all_threads(policy: int, priority: int) -> None:
    for thread in _threads(os.getpid()):
        with suppress(ProcessLookupError):  # the thread has ended
            os.sched_setscheduler(thread, policy, os.sched_param(priority))


def _threads(pid: int) -> list[int]:
    return [int(thread.name) for thread in Path(f"/proc/{pid}/task").iterdir()]


def _may_lock_without_limit() -> bool:
    if os.name != "posix" or not Path("/proc/self/status").exists():
        return False
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        return True
    for line in Path("/proc/self/status").read_text("ascii").splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> CAP_IPC_LOCK & 1)
    return False


# --- account --------------------------------------------------------------------------------------


class ProcessorAccount:
    """Processor time of this process; of the calling thread, the loop, also its waiting time."""

    def __init__(self) -> None:
        """Begin with nothing used."""
        self._process_ns, self._since_ns = time.process_time_ns(), time.monotonic_ns()
        self._ran_ns = [time.thread_time_ns()] * 2  # of the loop, at its last two steps
        self._waited_ns = waited_ns()

    def fraction(self) -> float:
        """Return the processor time of all threads since the last call, in cores."""
        process_ns, since_ns = self._process_ns, self._since_ns
        self._process_ns, self._since_ns = time.process_time_ns(), time.monotonic_ns()
        self._waited_ns = waited_ns()
        return (self._process_ns - process_ns) / max(self._since_ns - since_ns, 1)

    def begins(self) -> None:
        """Note the beginning of a step."""
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
