"""The bus of a cell for its processes: a role on the hub, or the hub itself."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from common.config.cell import CellConfig
from common.security.access_control import access_control, rate_limits
from forcemesh.bus import Bus
from forcemesh.clock import Clock, MonotonicClock
from forcemesh.identity import refuse_in_the_clear
from forcemesh.zenoh_session import open_router, open_session
from forcemesh.zenoh_settings import (
    MOST_SESSIONS,
    endpoint_of,
    security_of,
    session_settings,
)

# What no honest client needs more of: the longest message of the table has less than 4 kB.
LONGEST_MESSAGE_B = 16_384
LONGEST_TRANSPORT_MESSAGE_B = 65_536  # before the hub even knows what it is

SHORT = {
    "id": "no long messages",
    "flows": ["ingress"],
    "messages": ["put", "delete", "query", "reply"],
    "key_exprs": ["**"],
    "size_limit": LONGEST_MESSAGE_B,
}
HUB_TRANSPORT = {
    "unicast": {"max_sessions": MOST_SESSIONS},
    "link": {"rx": {"max_message_size": LONGEST_TRANSPORT_MESSAGE_B}},
}


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


def hub_settings(cell: CellConfig, endpoint: str, role: str = "hub") -> dict[str, Any]:
    """Return what makes a Zenoh router the hub of a cell; `zenohd` takes the same.

    Raises:
        BusError: As `open_hub`.
    """
    security = security_of(cell, role, endpoint)
    part: dict[str, Any] = {
        "mode": "router",
        "listen": {"endpoints": [endpoint]},
        "low_pass_filter": [SHORT],
    }
    if security:
        part |= {"access_control": access_control(cell), "downsampling": rate_limits(cell)}
    if cell.bus.upstream is not None:
        refuse_in_the_clear(cell, cell.bus.upstream.endpoint)
        part["connect"] = {
            "endpoints": [cell.bus.upstream.endpoint],
            "timeout_ms": -1,
            "exit_on_failure": False,
        }
    return session_settings(part, role, security, HUB_TRANSPORT)
