"""Fault injection into processes, with verification. Times are CLOCK_MONOTONIC [ns]."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from launch.started_process import ChildProcess

EFFECT_S = 2.0  # after SIGTERM a process may finish its work
POLL_S = 0.001


class NoEffectError(Exception):
    """Error: the injection had no effect on the process."""


def kill(running: ChildProcess) -> int:
    """Kill a process (SIGKILL); return the time."""
    return _hit(running, signal.SIGKILL)


def terminate(running: ChildProcess) -> int:
    """Terminate a process (SIGTERM); return the time."""
    return _hit(running, signal.SIGTERM)


def freeze(running: ChildProcess) -> int:
    """Freeze a process (SIGSTOP); return the time."""
    return _hit(running, signal.SIGSTOP)


def thaw(running: ChildProcess) -> int:
    """Thaw a frozen process (SIGCONT); return the time. Raises NoEffectError if not frozen."""
    if state_of(running.pid) != "T":
        raise NoEffectError(f"process {running.pid} was not frozen when it was to be thawed")
    return _hit(running, signal.SIGCONT)


def prove_ended(running: ChildProcess) -> None:
    """Wait until the process has ended. Raises NoEffectError if it does not."""
    _until(lambda: running.ended() is not None, f"process {running.pid} did not end")


def prove_frozen(running: ChildProcess) -> None:
    """Wait until the process is stopped. Raises NoEffectError if it is not."""
    _until(lambda: state_of(running.pid) == "T", f"process {running.pid} was not frozen")


def state_of(pid: int) -> str:
    """Return the kernel's state letter of a process (proc(5)), empty if it has ended."""
    with suppress(OSError):
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
        return stat.rpartition(")")[2].split()[0]
    return ""


def _hit(running: ChildProcess, number: signal.Signals) -> int:
    """Send a signal; return the time just before, taken at real-time priority."""
    with _ahead_of_ordinary_processes():
        now_ns = time.monotonic_ns()
        os.kill(running.pid, number)
    return now_ns


@contextmanager
def _ahead_of_ordinary_processes() -> Iterator[None]:
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _until(what: Callable[[], bool], otherwise: str) -> None:
    give_up_s = time.monotonic() + EFFECT_S
    while not what():
        if time.monotonic() > give_up_s:
            raise NoEffectError(otherwise)
        time.sleep(POLL_S)
