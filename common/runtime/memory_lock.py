"""Memory locking (mlockall): a page fault to swap costs a control loop milliseconds."""

import ctypes
import os
import resource
from pathlib import Path

MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4  # <sys/mman.h>
CAP_IPC_LOCK = 14  # <linux/capability.h>

_locked = False


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


def _may_lock_without_limit() -> bool:
    if os.name != "posix" or not Path("/proc/self/status").exists():
        return False
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        return True
    for line in Path("/proc/self/status").read_text("ascii").splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> CAP_IPC_LOCK & 1)
    return False
