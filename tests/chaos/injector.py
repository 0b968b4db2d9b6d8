"""Hits a process, and proves that it was hit. Times are CLOCK_MONOTONIC [ns]."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from launch.started_process import Running

BITES_WITHIN_S = 2.0  # SIGTERM lets a process finish what it does
POLL_S = 0.001


class NoBiteError(Exception):
    """The process did not do what the injection should have made it do."""


def kill(running: Running) -> int:
    """Take a process away at once; return when."""
    return _hit(running, signal.SIGKILL)


def terminate(running: Running) -> int:
    """Ask a process to end, as a person or a container does; return when."""
    return _hit(running, signal.SIGTERM)


def freeze(running: Running) -> int:
    """Stop a process in the middle of what it does; return when."""
    return _hit(running, signal.SIGSTOP)


def thaw(running: Running) -> int:
    """Let a frozen process go on; return when. Raises NoBiteError if it was not frozen."""
    if state_of(running.pid) != "T":
        raise NoBiteError(f"process {running.pid} was not frozen when it was to be thawed")
    return _hit(running, signal.SIGCONT)


def prove_gone(running: Running) -> None:
    """Wait until the process has ended. Raises NoBiteError if it does not."""
    _until(lambda: running.ended() is not None, f"process {running.pid} did not end")


def prove_frozen(running: Running) -> None:
    """Wait until the process is stopped. Raises NoBiteError if it is not."""
    _until(lambda: state_of(running.pid) == "T", f"process {running.pid} was not frozen")


def state_of(pid: int) -> str:
    """Return the kernel's letter for what a process does (proc(5)), empty when it is gone."""
    with suppress(OSError):
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
        return stat.rpartition(")")[2].split()[0]
    return ""


def _hit(running: Running, number: signal.Signals) -> int:
    """Send a signal; the time is taken just before, and nothing ordinary comes in between."""
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
    give_up_s = time.monotonic() + BITES_WITHIN_S
    while not what():
        if time.monotonic() > give_up_s:
            raise NoBiteError(otherwise)
        time.sleep(POLL_S)
