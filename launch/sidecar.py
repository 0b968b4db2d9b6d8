"""What runs beside a cell that is up: panel and recorder. What becomes of them stops nothing.

One that dies is started again, with the same patience as the processes of the cell.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from launch.processes import Supervisor
    from launch.started_process import Process

ENDS_WITHIN_S = 3.0
LOOK_S = 0.2
REFUSED = 2  # exit code of a process that says what is wrong


@contextmanager
def beside(
    module: str, name: str, supervisor: "Supervisor", *, wanted: bool = True
) -> Iterator[None]:
    """Run a helper of a cell that is up, for as long as this lasts."""
    if not wanted:
        yield
        return
    from launch.started_process import Process

    over, begun = threading.Event(), threading.Event()
    words = [Process(module, (name,)), supervisor, over, begun]
    thread = threading.Thread(target=_play, args=words, daemon=True)
    thread.start()
    begun.wait()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _play(
    process: "Process", supervisor: "Supervisor", over: threading.Event, begun: threading.Event
) -> None:
    """Run a helper until it is over; it dies with the thread that has started it, so in this one.

    One that says itself why it cannot run is not started again.
    """
    from launch.restart import Patience
    from launch.started_process import Running, say_on_stderr

    patience = Patience()
    while True:
        running = Running(process, supervisor.cell_file, say_on_stderr)
        supervisor.log.started(process, running.pid, is_helper=True)
        begun.set()
        while (died := running.ended()) is None and not over.wait(LOOK_S):
            pass
        if died is None or over.is_set():
            running.terminate()
            running.finish(ENDS_WITHIN_S)
            return
        running.finish(0.0)
        supervisor.log.ended(died)
        now_s = time.monotonic()
        due_s = None if died.code == REFUSED else patience.died(process.name, now_s)
        if due_s is None:
            what = f"there is no {process.name}: {died.how}"
            say_on_stderr("up", f"{what}; the cell goes on without it")
            return
        say_on_stderr("up", f"{process.name} died: {died.how}; it is started again")
        if over.wait(due_s - now_s):
            return
