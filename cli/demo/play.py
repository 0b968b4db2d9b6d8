"""Run of the demo's scenario on a cell: in real processes, or in one on a virtual clock."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from cli.demo.scenario import Progress, Scenario, ScenarioError, ScenarioPlan, Trace
from common.config.cell import CellConfig
from forcemesh.errors import ForcemeshError

REFRESH_S = 0.05


def play_virtual(
    cell: CellConfig, plan: ScenarioPlan, progress: Progress, _linger_s: float
) -> Trace:
    """Run in one process on a virtual clock."""
    from launch.virtual_cell import VirtualCell

    world = VirtualCell(cell)
    trace = Scenario(world.client, plan, check=lambda: None, progress=progress).run()
    trace.stages.clear()  # multiples of the virtual step are not latencies
    return trace


def play_real(
    cell: CellConfig,
    plan: ScenarioPlan,
    progress: Progress,
    linger_s: float,
    *,
    panel: bool = False,
    recorder: bool = False,
) -> Trace:
    """Start the cell's processes, run the scenario, and stop them all in any case.

    Raises:
        ScenarioError: A process died or the arm was stopped; after a death the cell stays up for
            `linger_s` before that, so that `forcemesh status` can be used.
        BusError: There was no reply, and no process died.
    """
    from common.bus.cell_bus import open_bus
    from forcemesh.topics import CLIENT
    from launch.processes import Supervisor
    from launch.sidecar import sidecars

    names = [name for name, is_on in (("recorder", recorder), ("panel", panel)) if is_on]
    with Supervisor(cell) as processes:

        def check() -> None:
            if processes.died:
                raise ScenarioError("a process of the cell died")

        processes.wait_ready()
        try:
            with sidecars(processes, names), open_bus(cell, CLIENT) as client:
                return Scenario(client, plan, check=check, progress=progress).run()
        except ForcemeshError as error:  # also a request without reply: its server may have died
            processes.hold_after_death(linger_s)
            if not processes.died:
                raise
            deaths = "; ".join(str(died) for died in processes.died)
            raise ScenarioError(f"{deaths}: {error}") from error


@contextmanager
def live_progress(screen: Console, plan: ScenarioPlan) -> Iterator[Progress]:
    """Show phase, force and torque while the scenario runs."""
    columns = (
        TextColumn("{task.description:<16}"),
        BarColumn(bar_width=30),
        TextColumn("{task.completed:5.1f} N  {task.fields[torque]:6.3f} N m"),
    )
    with Bar(*columns, console=screen, transient=False) as bar:
        task = bar.add_task("starting", total=plan.press_N, torque=0.0)
        last_s = [0.0]

        def progress(phase: str, force_N: float, torque_Nm: float) -> None:
            now_s = time.monotonic()
            if now_s - last_s[0] > REFRESH_S:
                last_s[0] = now_s
                bar.update(task, description=phase, completed=force_N, torque=torque_Nm)

        yield progress
