"""Launcher of a process that cannot outlive its supervisor. Run as a script; ends in exec.

With PR_SET_PDEATHSIG Linux kills a process when the thread that started it ends; the setting
survives exec. A function between fork and exec would do the same, but is not safe with threads.
Other systems have no such setting: there a supervisor that is killed leaves orphans.
The process gets normal priority, also from a real-time parent: see common/runtime/realtime.py.
"""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1


def main() -> None:
    """Read the supervisor's pid and a command from the arguments, and exec that command."""
    supervisor_pid, *command = sys.argv[1:]
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != int(supervisor_pid):
        sys.exit("the supervisor ended before this process began")
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.execv(command[0], command)  # noqa: S606 - no shell is needed


if __name__ == "__main__":
    main()
