"""What runs beside a cell that is up: panel and recorder. What becomes of them stops nothing."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cli.processes import Supervisor
    from cli.runlog import RunLog
    from cli.running import Running

ENDS_WITHIN_S = 3.0
LOOK_S = 0.2


@contextmanager
def beside(
    module: str, name: str, supervisor: "Supervisor", *, wanted: bool = True
) -> Iterator[None]:
    """Run a helper of a cell that is up, for as long as this lasts; say when it ends by itself."""
    if not wanted:
        yield
        return
    from cli.running import Process, Running, say_on_stderr

    process, log = Process(module, (name,)), supervisor.log
    running = Running(process, supervisor.cell_file, say_on_stderr)
    log.started(process, running.pid, is_helper=True)
    over = threading.Event()
    threading.Thread(target=_mourn, args=[running, log, over], daemon=True).start()
    try:
        yield
    finally:
        over.set()
        running.terminate()
        running.finish(ENDS_WITHIN_S)


def _mourn(running: "Running", log: "RunLog", over: threading.Event) -> None:
    from cli.running import say_on_stderr

    while not over.wait(LOOK_S):
        if (died := running.ended()) is not None:
            if not over.is_set():
                log.ended(died)
                what = f"there is no {running.process.name}: {died.how}"
                say_on_stderr("up", f"{what}; the cell goes on without it")
            return
