"""Memory that stays in memory: a page that was swapped out costs a control loop milliseconds."""

import ctypes
import os
import resource
from pathlib import Path

MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4  # <sys/mman.h>
CAP_IPC_LOCK = 14  # <linux/capability.h>

_locked = False


def lock_memory() -> bool:
    """Lock this process's pages, those to come at their first use; tell whether it was allowed.

    Only without a limit (`ulimit -l unlimited`, or CAP_IPC_LOCK): under a limit the kernel would
    refuse memory later, in the middle of the work.
    """
    global _locked  # noqa: PLW0603 - it is a property of the process
    if not _may_lock_without_limit():
        return False
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        _locked = bool(libc.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0)
    except (OSError, AttributeError):  # not Linux
        return False
    return _locked


def is_memory_locked() -> bool:
    """Tell whether `lock_memory` was allowed in this process."""
    return _locked


def _may_lock_without_limit() -> bool:
    if os.name != "posix" or not Path("/proc/self/status").exists():
        return False
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        return True
    for line in Path("/proc/self/status").read_text("ascii").splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> CAP_IPC_LOCK & 1)
    return False
