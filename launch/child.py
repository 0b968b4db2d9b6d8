"""Becomes a process of a cell that cannot outlive its supervisor. Run as a script; ends in exec.

Linux kills a process that asked for it when the thread that started it ends, and the wish survives
exec. A function between fork and exec would do the same, but is not safe once there are threads.
Elsewhere than on Linux the wish cannot be made: there a supervisor that is killed leaves orphans.
It starts as an ordinary process, also when whoever starts it goes first: see
common/runtime/priority.py.
"""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1


def main() -> None:
    """Take the supervisor's pid and a command from the arguments, and become that command."""
    supervisor_pid, *command = sys.argv[1:]
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != int(supervisor_pid):
        sys.exit("the supervisor ended before this process began")
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.execv(command[0], command)  # noqa: S606 - the shell is what is not wanted


if __name__ == "__main__":
    main()
