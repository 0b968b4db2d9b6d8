"""Verb `up`: runs the processes of a cell."""

import signal
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.context import (
    CELL_VARIABLE,
    NOT_WELL,
    USAGE,
    default_cell_file,
    exit_with_error,
    one_line_errors,
)
from cli.panel import NoPanel, panel_sidecar
from cli.record import NoRecorder, recorder_sidecar

if TYPE_CHECKING:
    from common.config.cell import CellConfig
    from launch.processes import Supervisor

SUPERVISOR_POLL_S = 0.05
SLOW_S = 15.0


def up(
    cell: Annotated[
        Path | None,
        typer.Option(
            "--cell",
            envvar=CELL_VARIABLE,
            metavar="FILE",
            help="Cell file; default: cells/demo.yaml.",
            show_default=False,
        ),
    ] = None,
    linger: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Time to keep the others up when a process has failed for good [s]; default: "
            "until Ctrl-C, or 5 s if the cell was never ready.",
            show_default=False,
        ),
    ] = None,
    *,
    no_panel: NoPanel = False,
    no_recorder: NoRecorder = False,
) -> None:
    """Start the processes of a cell, its panel and recorder; stop all on Ctrl-C.

    A process that dies is restarted and the arm held; after repeated deaths it is not restarted.
    """
    stop = threading.Event()
    with one_line_errors():
        from common.config.load import load_cell
        from launch.processes import Supervisor

        path = cell or default_cell_file()
        loaded = load_cell(path)
    from forcemesh.errors import ForcemeshError

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    supervisor = Supervisor(loaded, path, stop=stop)
    try:
        supervisor.__enter__()
    except ForcemeshError as error:
        exit_with_error(f"up: {error}", USAGE)
    with ExitStack() as afterwards:  # sidecars end last: the arm is stopped first

        def start_helpers() -> None:
            afterwards.enter_context(recorder_sidecar(supervisor, enabled=not no_recorder))
            afterwards.enter_context(panel_sidecar(supervisor, enabled=not no_panel))

        try:
            _supervise(supervisor, loaded, path, stop=stop, when_ready=start_helpers)
            if supervisor.died:
                supervisor.hold_after_death(linger)
        finally:
            supervisor.stop()
    if supervisor.died:
        exit_with_error("; ".join(f"died: {died}" for died in supervisor.died), NOT_WELL)
    typer.echo(f"cell {loaded.cell} is down", err=True)


def _supervise(
    supervisor: "Supervisor",
    cell: "CellConfig",
    path: Path,
    *,
    stop: threading.Event,
    when_ready: Callable[[], None],
) -> None:
    """Wait for the end: Ctrl-C, or a death. Report once that the cell is ready, or what is missing.

    The sidecar processes start when the cell is ready, so that they do not delay it.
    """
    import time

    started_s, is_slow_reported, ready = time.monotonic(), False, False
    while not stop.wait(SUPERVISOR_POLL_S) and not supervisor.died:
        supervisor.restart_exited()
        lines = supervisor.missing()
        elapsed_s = time.monotonic() - started_s
        if not ready and not lines:
            ready = True
            supervisor.enable_restarts()
            when_ready()
            typer.echo(f"cell {cell.cell} ({path}) is up; Ctrl-C stops it", err=True)
        elif not ready and not is_slow_reported and elapsed_s > SLOW_S:
            is_slow_reported = True
            typer.echo(f"after {elapsed_s:.0f} s still waiting: {'; '.join(lines)}", err=True)
