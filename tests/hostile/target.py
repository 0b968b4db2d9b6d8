"""Cell in real processes as the target of the hostile client."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from common.config.cell import CellConfig
from launch.processes import Supervisor, processes_of
from launch.started_process import ProcessSpec
from tests.chaos.common_net import HarnessError, free_port, log_to, make_cell
from tests.hostile.client import HostileClient, connected


def make_target(folder: Path, overrides: dict[str, object]) -> tuple[CellConfig, Path]:
    """Write a cell file of the demo with a name, a port and recordings of its own."""
    port = free_port()
    own = {"bus.endpoint": f"tcp/127.0.0.1:{port}", "recorder.folder": str(folder)}
    return make_cell("demo", folder, {"cell": f"demo-{port}", **own, **overrides})


@contextmanager
def client_of(
    cell: CellConfig, path: Path, roles: frozenset[str] = frozenset()
) -> Iterator[HostileClient]:
    """Start a cell and its recorder, or the processes of some roles alone; yield a client.

    Raises:
        HarnessError: A process has ended.
    """
    processes = (*processes_of(cell), ProcessSpec("services.recorder", ("recorder",)))
    if roles:
        processes = tuple(each for each in processes if roles.intersection(each.roles))
    with Supervisor(cell, path, processes=processes, write_line=log_to(path.parent)) as supervisor:
        if not roles:
            supervisor.wait_ready()
        session = connected(cell.bus.endpoint)
        try:
            yield HostileClient(session, cell.cell, seed=1)
        finally:
            session.close()
        if supervisor.died:
            raise HarnessError("; ".join(map(str, supervisor.died)))
