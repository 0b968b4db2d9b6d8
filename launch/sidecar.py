"""Sidecar processes of a running cell: panel and recorder. Their failure does not stop the cell.

A sidecar that dies is restarted with the same back-off and limit as the processes of the cell.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from launch.processes import Supervisor
    from launch.started_process import ProcessSpec

SIDECAR_ENDS_WITHIN_S = 3.0
SIDECAR_POLL_S = 0.2
CANNOT_RUN_CODE = 2  # exit code of a process that has reported why it cannot run


@contextmanager
def sidecar(
    module: str, name: str, supervisor: "Supervisor", *, enabled: bool = True
) -> Iterator[None]:
    """Run a sidecar process while the context is open."""
    if not enabled:
        yield
        return
    from launch.started_process import ProcessSpec

    stop, started = threading.Event(), threading.Event()
    arguments = [ProcessSpec(module, (name,)), supervisor, stop, started]
    thread = threading.Thread(target=_run, args=arguments, daemon=True)
    thread.start()
    started.wait()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _run(
    process: "ProcessSpec",
    supervisor: "Supervisor",
    stop: threading.Event,
    started: threading.Event,
) -> None:
    """Run a sidecar process until `stop` is set; it would die with the thread that starts it.

    A process that has reported why it cannot run is not restarted.
    """
    from launch.restart import RestartPolicy
    from launch.started_process import ChildProcess, write_stderr_line

    policy = RestartPolicy()
    while True:
        running = ChildProcess(process, supervisor.cell_file, write_stderr_line)
        supervisor.log.add_process(process, running.pid, is_helper=True)
        started.set()
        while (died := running.ended()) is None and not stop.wait(SIDECAR_POLL_S):
            pass
        if died is None or stop.is_set():
            running.terminate()
            running.finish(SIDECAR_ENDS_WITHIN_S)
            return
        running.finish(0.0)
        supervisor.log.add_exit(died)
        now_s = time.monotonic()
        due_s = None if died.code == CANNOT_RUN_CODE else policy.restart_time_s(process.name, now_s)
        if due_s is None:
            text = f"{process.name} is not running: {died.cause}"
            write_stderr_line("up", f"{text}; the cell continues without it")
            return
        write_stderr_line("up", f"{process.name} died: {died.cause}; it is restarted")
        if stop.wait(due_s - now_s):
            return
