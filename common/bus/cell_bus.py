"""The bus of a cell for its processes: a role on the hub, or the hub itself."""

from collections.abc import Iterator
from contextlib import contextmanager

from common.bus.hub_settings import hub_settings
from common.config.cell import CellConfig
from forcemesh.bus import Bus
from forcemesh.clock import Clock, MonotonicClock
from forcemesh.zenoh_session import open_router, open_session
from forcemesh.zenoh_settings import endpoint_of


@contextmanager
def open_bus(
    cell: CellConfig, role: str, *, clock: Clock | None = None, patience_s: float = 10.0
) -> Iterator[Bus]:
    """Connect a role to its cell's hub; close the session in any case.

    Raises:
        BusError: As `open_session`.
    """
    with open_session(cell, role, patience_s) as transport:
        yield Bus(role, cell.cell, transport, cell, clock or MonotonicClock())


@contextmanager
def open_hub(cell: CellConfig, role: str = "hub", *, clock: Clock | None = None) -> Iterator[Bus]:
    """Be the cell's hub: a Zenoh router that listens on the cell's endpoint.

    Raises:
        BusError: The endpoint cannot be listened on, is open to other machines without
            encryption, or lacks a certificate.
    """
    endpoint = endpoint_of(cell)
    with open_router(hub_settings(cell, endpoint, role), endpoint) as transport:
        yield Bus(role, cell.cell, transport, cell, clock or MonotonicClock())
