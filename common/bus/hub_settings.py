"""Settings of a cell's hub: access control, rate limits, lengths of messages."""

from typing import Any

from common.config.cell import CellConfig
from common.security.access_control import access_control, rate_limits
from forcemesh.identity import refuse_in_the_clear
from forcemesh.zenoh_settings import security_of, session_settings

# What no honest client needs more of: the longest message of the table has less than 4 kB.
LONGEST_MESSAGE_B = 16_384
LONGEST_TRANSPORT_MESSAGE_B = 65_536  # before the hub even knows what it is
MOST_CLIENTS = 64

SHORT = {
    "id": "no long messages",
    "flows": ["ingress"],
    "messages": ["put", "delete", "query", "reply"],
    "key_exprs": ["**"],
    "size_limit": LONGEST_MESSAGE_B,
}
HUB_TRANSPORT = {
    "unicast": {"max_sessions": MOST_CLIENTS},
    "link": {"rx": {"max_message_size": LONGEST_TRANSPORT_MESSAGE_B}},
}


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
