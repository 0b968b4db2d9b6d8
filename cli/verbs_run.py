"""Verbs that run processes: `up` those of a cell, `bench` the benchmarks of the project."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Context, Exit, Option, Typer

from cli.context import (
    CELL_VARIABLE,
    INTERRUPTED,
    NOT_WELL,
    default_cell_file,
    exit_with_error,
    one_line_errors,
    print_note,
)
from cli.panel import NoPanel
from cli.record import NoRecorder
from forcemesh.errors import ForcemeshError
from forcemesh.topics import HELPERS

if TYPE_CHECKING:
    from common.config.cell import CellConfig
    from common.runtime.stop import StopSignal
    from launch.processes import Supervisor

bench = Typer(no_args_is_help=True, help="Benchmarks of the project; need its checkout.")

ROOT = Path(__file__).resolve().parent.parent
PASSED_ON = {"allow_extra_args": True, "ignore_unknown_options": True}
SUPERVISOR_POLL_S = 0.05
SLOW_S = 15.0


def up(
    cell: Annotated[
        Path | None,
        Option(
            "--cell",
            envvar=CELL_VARIABLE,
            metavar="FILE",
            help="Cell file; default: cells/demo.yaml.",
        ),
    ] = None,
    linger: Annotated[
        float | None,
        Option(
            min=0.0,
            help="Time to keep the others up when a process has failed for good [s]; default: "
            "until Ctrl-C, or 5 s if the cell was never ready.",
        ),
    ] = None,
    *,
    no_panel: NoPanel = False,
    no_recorder: NoRecorder = False,
) -> None:
    """Start the processes of a cell, its panel and recorder; stop all on Ctrl-C.

    A process that dies is restarted and the arm held; after repeated deaths it is not restarted.
    """
    with one_line_errors():
        from common.config.load import load_cell
        from common.runtime.stop import stop_on_signals
        from launch.processes import Supervisor

        path = cell or default_cell_file()
        loaded = load_cell(path)

    stop = stop_on_signals(signal.SIGHUP)
    try:
        supervisor = Supervisor(loaded, path, stop=stop).__enter__()
    except ForcemeshError as error:
        exit_with_error(f"up: {error}")
    off = {"recorder": no_recorder, "panel": no_panel}
    helpers = [name for name in (*HELPERS, "panel") if not off.get(name)]
    try:
        _supervise(supervisor, loaded, path, stop=stop, helpers=helpers)
        if supervisor.died:
            supervisor.hold_after_death(linger)
    finally:
        supervisor.stop()
    if supervisor.died:
        exit_with_error("; ".join(f"died: {died}" for died in supervisor.died), NOT_WELL)
    print_note(f"cell {loaded.cell} is down")


def _supervise(
    supervisor: "Supervisor",
    cell: "CellConfig",
    path: Path,
    *,
    stop: "StopSignal",
    helpers: list[str],
) -> None:
    """Wait for the end: Ctrl-C, or a death. Report once that the cell is ready, or what is missing.

    Panel and helpers start when the cell is ready, so that they do not delay it.
    """
    started_s, is_slow_reported, ready = time.monotonic(), False, False
    while not stop.wait(SUPERVISOR_POLL_S) and not supervisor.died:
        supervisor.restart_exited()
        lines = supervisor.missing()
        elapsed_s = time.monotonic() - started_s
        if not ready and not lines:
            ready = True
            supervisor.enable_restarts()
            supervisor.start_helpers(helpers)
            print_note(f"cell {cell.cell} ({path}) is up; Ctrl-C stops it")
        elif not ready and not is_slow_reported and elapsed_s > SLOW_S:
            is_slow_reported = True
            print_note(f"after {elapsed_s:.0f} s still waiting: {'; '.join(lines)}")


@bench.command("force", context_settings=PASSED_ON)
def force(
    context: Context,
    *,
    quick: Annotated[bool, Option("--quick", help="A few cases.")] = False,
    as_json: Annotated[bool, Option("--json", help="Print JSON.")] = False,
    write: Annotated[
        bool, Option("--write", help="Store docs/results/force.json and write docs/force.md.")
    ] = False,
) -> None:
    """Benchmark how the laws release, hold, approach and track a force, against other laws.

    Simulates its own cell in virtual time. Other options are passed to `python -m bench force`.
    """
    flags = {"--quick": quick, "--json": as_json, "--write": write}
    chosen = [name for name, is_chosen in flags.items() if is_chosen]
    if not (ROOT / "bench" / "force").is_dir():
        text = "bench not found: the benchmarks need a checkout of the project"
        exit_with_error(f"{text}, `git clone` it and `make setup`")
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-m", "bench", "force", *chosen, *context.args]
    try:
        code = subprocess.run(command, env=environment, check=False).returncode
    except KeyboardInterrupt:
        code = INTERRUPTED
    raise Exit(code)
