"""The verb `panel`, and the panel that `up` and `demo` start beside a cell."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.context import CellOption, find_cell_file, one_line_errors

if TYPE_CHECKING:
    from cli.running import Running

WITHOUT_VARIABLE = "FORCEMESH_NO_PANEL"
ENDS_WITHIN_S = 3.0
LOOK_S = 0.2

NoPanel = Annotated[
    bool,
    typer.Option(
        "--no-panel", envvar=WITHOUT_VARIABLE, help="Start no panel in the browser beside it."
    ),
]


def panel(
    *,
    view_only: Annotated[
        bool, typer.Option("--view-only", help="Nobody may act on the page.")
    ] = False,
    open_: Annotated[
        bool, typer.Option("--open", help="Open it in this machine's browser.")
    ] = False,
    host: Annotated[
        str | None, typer.Option(help="Where to listen; anything but this machine wants a token.")
    ] = None,
    port: Annotated[int | None, typer.Option(min=1, max=65535, help="On which port.")] = None,
    cell: CellOption = None,
) -> None:
    """Serve the cockpit of a cell in the browser: arm, plots, force, moves, calibration, faults."""
    words = ["--cell", str(find_cell_file(cell))]
    for name, value in (("--host", host), ("--port", port)):
        words += [name, str(value)] if value is not None else []
    words += ["--view-only"] if view_only else []
    words += ["--open"] if open_ else []
    with one_line_errors():
        from services.panel.__main__ import main

        main(words)


@contextmanager
def beside(cell_file: Path, *, wanted: bool = True) -> Iterator[None]:
    """Serve the panel of a cell that is up, for as long as this lasts.

    It is no part of the cell: what becomes of it is said, and stops nothing.
    """
    if not wanted:
        yield
        return
    from cli.running import Process, Running, say_on_stderr

    running = Running(Process("services.panel", ("panel",)), cell_file, say_on_stderr)
    over = threading.Event()
    threading.Thread(target=_mourn, args=[running, over], daemon=True).start()
    try:
        yield
    finally:
        over.set()
        running.terminate()
        running.finish(ENDS_WITHIN_S)


def _mourn(running: "Running", over: threading.Event) -> None:
    """Say when the panel has ended by itself."""
    from cli.running import say_on_stderr

    while not over.wait(LOOK_S):
        if (died := running.ended()) is not None:
            if not over.is_set():
                say_on_stderr("up", f"there is no panel: {died.how}; the cell goes on without it")
            return
