"""How a cell is: what the bus says, put together with what its supervisor's run file says."""

import time
from typing import TypedDict

from cli.cellview import CellView
from cli.runfile import Run
from common import topics
from common.bus import open_bus
from common.cell import Cell
from common.errors import BusError
from common.messages import Health

DOWN = "DOWN"
CONNECT_WITHIN_S = 0.5


class ServiceStatus(TypedDict):
    """One role of the cell."""

    name: str
    pid: int | None
    alive: bool
    rate_hz: float | None
    age_s: float | None
    fault: str


class CellStatus(TypedDict):
    """What `forcemesh status --json` prints."""

    cell: str
    state: str
    commander: str
    trips: list[dict[str, object]]
    not_ready: list[str]
    clears: str
    last_state: str
    services: list[ServiceStatus]


def cell_status(cell: Cell, run: Run | None, only: str | None = None) -> CellStatus:
    """Return how a cell is; needs no hub to answer.

    Args:
        cell: The cell.
        run: What its supervisor wrote, if it has one.
        only: The one role to wait for; otherwise all of them.
    """
    try:
        with open_bus(cell, topics.CLIENT, patience_s=CONNECT_WITHIN_S) as bus:
            view = CellView(bus, cell)
            started_s = time.monotonic()
            view.wait(lambda: _is_heard(view, only), view.longest_wait_s)
            return _judge(cell, run, view, time.monotonic() - started_s)
    except BusError:
        return _judge(cell, run, None, 0.0)


def is_well(status: CellStatus) -> bool:
    """Tell whether everything is alive and nothing complains."""
    silent = status["state"] in (DOWN, "FAULT")
    return not silent and all(row["alive"] and not row["fault"] for row in status["services"])


def _is_heard(view: CellView, only: str | None) -> bool:
    if only is not None:
        return not view.health(only).fault
    return view.arbiter().fresh is not None and all(
        view.health(role).message is not None for role in topics.ROLES
    )


def _judge(cell: Cell, run: Run | None, view: CellView | None, waited_s: float) -> CellStatus:
    heard = None if view is None else view.arbiter().fresh
    return CellStatus(
        cell=cell.cell,
        state=DOWN if heard is None else heard.state,
        commander="none" if heard is None else heard.commander,
        trips=[] if heard is None else [trip.model_dump() for trip in heard.trips],
        not_ready=[] if heard is None else list(heard.not_ready),
        clears="" if heard is None else heard.clears,
        last_state=run.last_state if run else "",
        services=[_service(role, run, view, waited_s) for role in topics.ROLES],
    )


def _service(role: str, run: Run | None, view: CellView | None, waited_s: float) -> ServiceStatus:
    entry = run.entry(role) if run else None
    row = ServiceStatus(
        name=role,
        pid=entry.pid if entry else None,
        alive=False,
        rate_hz=None,
        age_s=None,
        fault=f"{_why_silent(role, run)}no hub answers" if view is None else "",
    )
    if view is None:
        return row
    reading = view.health(role)
    message = reading.message
    if message is not None:
        row["age_s"] = round(reading.age_s, 3)
    if isinstance(message, Health):
        row["pid"], row["rate_hz"] = message.pid, round(message.rate_hz, 1)
        row["fault"] = message.fault
    row["alive"] = not reading.fault and not (entry and entry.ended)
    if not row["alive"]:
        silent_s = waited_s if message is None else reading.age_s
        row["fault"] = f"{_why_silent(role, run)}no health for {silent_s:.1f} s"
    return row


def _why_silent(role: str, run: Run | None) -> str:
    """Return what the run file and the process table know of a role that is not heard."""
    entry = run.entry(role) if run else None
    if run is None or entry is None:
        return ""
    if entry.ended is not None:
        return f"{entry.ended.how}; "
    if entry.alive:
        return f"process {entry.pid} runs, but "
    dead = [e for e in run.processes if e.ended is not None]
    if run.ended_at is not None and dead:
        causes = ", ".join(f"{e.roles[0]} was {e.ended.how}" for e in dead if e.ended)
        return f"stopped after {causes}; "
    if not run.live:
        return "ended with its supervisor; "
    return f"process {entry.pid} is gone; "
