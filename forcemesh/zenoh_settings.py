"""Zenoh settings: endpoint of the hub, identity, filters of the hub. Pure except for files."""

import os
import re
from collections.abc import Mapping
from typing import Any

from forcemesh.connection import Reachable
from forcemesh.errors import ConfigError
from forcemesh.identity import identity_of, is_encrypted, refuse_in_the_clear
from forcemesh.topics import CLIENT, HELPERS

ENDPOINT_VARIABLE = "FORCEMESH_ENDPOINT"
ENDPOINT = r"[a-z-]+/\S+"
RUNTIME_VARIABLE = "ZENOH_RUNTIME"
ONE_THREAD = (
    "(rx: (worker_threads: 1), app: (handover: rx), tx: (handover: rx), acc: (handover: rx))"
)
CONNECT_ATTEMPT_MS = 500
MOST_SESSIONS = 64  # that a hub serves at once
ROOM_B = 4_000_000  # doubled by the kernel for its overhead
LEASE_MS = 500
# Transmit queue length per priority. Real-time messages are not batched: with Zenoh's default of
# two, the third message within a millisecond is dropped.
WAITING = {"real_time": 16, "data": 16}
# Each message not yet taken occupies a buffer of this size, which is cleared before use: with
# Zenoh's 64 kB, clearing is a third of the cost of receiving a cell.
BATCH_B = 8192


def use_one_thread() -> None:
    """Configure Zenoh to receive and send with one thread instead of five, before its first use.

    Each message wakes most of the five; `make bench ARGS=chain` shows them. In the hub,
    a connection wakes the thread that accepted it for each message, besides the one that reads it.
    """
    os.environ.setdefault(RUNTIME_VARIABLE, ONE_THREAD)


def endpoint_of(cell: Reachable) -> str:
    """Return the endpoint of the hub: from the environment, else from the cell file.

    Raises:
        ConfigError: The value in the environment is not an endpoint.
    """
    moved = os.environ.get(ENDPOINT_VARIABLE)
    if moved and not re.fullmatch(ENDPOINT, moved):
        raise ConfigError(
            ENDPOINT_VARIABLE, [f"{moved!r} is not an endpoint such as tcp/127.0.0.1:7447"]
        )
    return moved or cell.bus.endpoint


def client_settings(endpoint: str, role: str, security: Mapping[str, object]) -> dict[str, Any]:
    """Return the Zenoh configuration of a client; it tries to connect once."""
    part = {
        "mode": "client",
        "connect": {
            "endpoints": [with_room(endpoint) if role in HELPERS else endpoint],
            "timeout_ms": CONNECT_ATTEMPT_MS,
            "exit_on_failure": True,
            "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        },
    }
    return session_settings(part, role, security)


def with_room(endpoint: str) -> str:
    """Return an endpoint with a receive buffer for seconds of traffic, if the machine allows it.

    For a process that must not lose messages but runs at lower priority than the control loops.
    """
    scheme, _, where = endpoint.partition("/")
    if scheme not in ("tcp", "tls") or "so_rcvbuf" in where:
        return endpoint
    return f"{endpoint}{';' if '#' in where else '#'}so_rcvbuf={ROOM_B}"


def security_of(cell: Reachable, role: str, endpoint: str) -> Mapping[str, object]:
    """Return Zenoh's settings of a role's certificate; empty when none is required."""
    refuse_in_the_clear(cell, endpoint)
    return identity_of(cell, role).settings() if is_encrypted(endpoint) else {}


def certificate_name(cell: Reachable) -> str:
    """Return the name of a client's certificate, empty on a bus without certificates."""
    return identity_of(cell, CLIENT).name if is_encrypted(endpoint_of(cell)) else ""


def session_settings(
    part: Mapping[str, Any],
    name: str,
    security: Mapping[str, object],
    transport: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return Zenoh's settings of one session: its own part, and what all of ours have."""
    own = transport or {}
    link = {
        **own.get("link", {}),
        "tx": {
            "lease": LEASE_MS,
            "keep_alive": 4,
            "queue": {"size": WAITING},
            "batch_size": BATCH_B,
        },
    }
    if security:
        link |= {"protocols": ["tls", "quic"], "tls": security}
    return {
        **part,
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {**own, "link": link, "shared_memory": {"enabled": False}},
        "metadata": {"name": name},
    }
