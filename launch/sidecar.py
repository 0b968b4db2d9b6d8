"""Sidecar processes of a running cell: panel and helpers. Their failure does not stop the cell.

A sidecar that dies is restarted with the same back-off and limit as the processes of the cell.
"""

import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from forcemesh.topics import HELPERS
from launch.processes import Supervisor
from launch.restart import RestartPolicy
from launch.started_process import ChildProcess, ProcessSpec, write_stderr_line

SIDECARS = {name: f"services.{name}" for name in (*HELPERS, "panel")}
SIDECAR_ENDS_WITHIN_S = 3.0
SIDECAR_POLL_S = 0.2
CANNOT_RUN_CODE = 2  # exit code of a process that has reported why it cannot run


@contextmanager
def sidecars(supervisor: Supervisor, names: Iterable[str]) -> Iterator[None]:
    """Run sidecar processes of a cell while the context is open."""
    stop, started = threading.Event(), threading.Semaphore(0)
    threads = [
        threading.Thread(target=_run, args=[name, supervisor, stop, started], daemon=True)
        for name in names
    ]
    for thread in threads:
        thread.start()
        started.acquire()
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def _run(
    name: str, supervisor: Supervisor, stop: threading.Event, started: threading.Semaphore
) -> None:
    """Run a sidecar process until `stop` is set; it would die with the thread that starts it.

    A process that has reported why it cannot run is not restarted.
    """
    process, policy = ProcessSpec(SIDECARS[name], (name,)), RestartPolicy()
    while True:
        running = ChildProcess(process, supervisor.cell_file, write_stderr_line)
        supervisor.log.add_process(process, running.pid, is_helper=True)
        started.release()
        while (died := running.ended()) is None and not stop.wait(SIDECAR_POLL_S):
            pass
        if died is None or stop.is_set():
            running.terminate()
            running.finish(SIDECAR_ENDS_WITHIN_S)
            return
        running.finish(0.0)
        supervisor.log.add_exit(died)
        now_s = time.monotonic()
        due_s = None if died.code == CANNOT_RUN_CODE else policy.restart_time_s(name, now_s)
        if due_s is None:
            text = f"{name} is not running: {died.cause}"
            write_stderr_line("up", f"{text}; the cell continues without it")
            return
        write_stderr_line("up", f"{name} died: {died.cause}; it is restarted")
        if stop.wait(due_s - now_s):
            return
