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
LOOK_S = 0.2
REFUSED = 2  # exit code of a process that has reported why it cannot run


@contextmanager
def sidecar(
    module: str, name: str, supervisor: "Supervisor", *, wanted: bool = True
) -> Iterator[None]:
    """Run a sidecar process while the context is open."""
    if not wanted:
        yield
        return
    from launch.started_process import ProcessSpec

    over, begun = threading.Event(), threading.Event()
    words = [ProcessSpec(module, (name,)), supervisor, over, begun]
    thread = threading.Thread(target=_play, args=words, daemon=True)
    thread.start()
    begun.wait()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _play(
    process: "ProcessSpec", supervisor: "Supervisor", over: threading.Event, begun: threading.Event
) -> None:
    """Run a sidecar process until `over` is set; it would die with the thread that starts it.

    A process that has reported why it cannot run is not restarted.
    """
    from launch.restart import RestartPolicy
    from launch.started_process import ChildProcess, say_on_stderr

    patience = RestartPolicy()
    while True:
        running = ChildProcess(process, supervisor.cell_file, say_on_stderr)
        supervisor.log.started(process, running.pid, is_helper=True)
        begun.set()
        while (died := running.ended()) is None and not over.wait(LOOK_S):
            pass
        if died is None or over.is_set():
            running.terminate()
            running.finish(SIDECAR_ENDS_WITHIN_S)
            return
        running.finish(0.0)
        supervisor.log.ended(died)
        now_s = time.monotonic()
        due_s = None if died.code == REFUSED else patience.died(process.name, now_s)
        if due_s is None:
            what = f"{process.name} is not running: {died.how}"
            say_on_stderr("up", f"{what}; the cell continues without it")
            return
        say_on_stderr("up", f"{process.name} died: {died.how}; it is restarted")
        if over.wait(due_s - now_s):
            return
