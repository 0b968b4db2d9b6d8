"""The bus between processes: Zenoh. Who connects to whom, and what happens when the hub is lost.

One hub (a Zenoh router) and every process its client with an explicit endpoint; no multicast, no
gossip, no shared memory. Streams drop when congested and readers keep the newest only, so that a
slow reader can never hold a writer up. Only this file and `zenoh_transport` import Zenoh.
"""

import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import zenoh

from common.cell import Cell
from common.clock import Clock, MonotonicClock
from common.endpoints import Bus
from common.errors import BusError
from common.zenoh_transport import ZenohTransport

ENDPOINT_VARIABLE = "FORCEMESH_ENDPOINT"
CONNECT_ATTEMPT_MS = 500
LEASE_MS = 500
RETRY_S = 0.1
LOOK_S = 0.05  # how long a lost hub may go unnoticed
# What no honest client needs more of: the longest message of the table has less than 4 kB.
LONGEST_MESSAGE_B = 16_384
LONGEST_TRANSPORT_MESSAGE_B = 65_536  # before the hub even knows what it is
MOST_CLIENTS = 64


def endpoint_of(cell: Cell) -> str:
    """Return where the hub is: the environment may move it, the cell file says where it is."""
    return os.environ.get(ENDPOINT_VARIABLE) or cell.bus.endpoint


@contextmanager
def open_bus(
    cell: Cell, role: str, *, clock: Clock | None = None, patience_s: float = 10.0
) -> Iterator[Bus]:
    """Connect a role to its cell's hub; close the session in any case.

    Raises:
        BusError: The hub did not answer within `patience_s`.
    """
    endpoint = endpoint_of(cell)
    transport = ZenohTransport(_connect(endpoint, role, patience_s))
    ended = threading.Event()
    words = (transport, lambda: _try_to_connect(endpoint, role), ended)
    keeper = threading.Thread(target=_keep_connected, args=words, daemon=True)
    keeper.start()
    try:
        yield Bus(role, cell.cell, transport, cell, clock or MonotonicClock())
    finally:
        ended.set()
        keeper.join()
        transport.close()


@contextmanager
def open_hub(cell: Cell, role: str = "hub", *, clock: Clock | None = None) -> Iterator[Bus]:
    """Be the cell's hub: a Zenoh router that listens on the cell's endpoint.

    Raises:
        BusError: The endpoint cannot be listened on.
    """
    endpoint = endpoint_of(cell)
    listen = {"mode": "router", "listen": {"endpoints": [endpoint]}, "low_pass_filter": [SHORT]}
    try:
        session = zenoh.open(_config(listen, role, HUB_TRANSPORT))
    except zenoh.ZError as error:
        raise BusError(f"cannot listen on {endpoint}: is another hub running there?") from error
    try:
        yield Bus(role, cell.cell, ZenohTransport(session), cell, clock or MonotonicClock())
    finally:
        with suppress(zenoh.ZError):
            session.close()


def _connect(endpoint: str, role: str, patience_s: float) -> zenoh.Session:
    give_up = time.monotonic() + patience_s
    while (session := _try_to_connect(endpoint, role)) is None:
        if time.monotonic() >= give_up:
            raise BusError(f"no hub at {endpoint}: is the cell up?")
        time.sleep(RETRY_S)
    return session


def _try_to_connect(endpoint: str, role: str) -> zenoh.Session | None:
    connect = {
        "mode": "client",
        "connect": {
            "endpoints": [endpoint],
            "timeout_ms": CONNECT_ATTEMPT_MS,
            "exit_on_failure": True,
        },
    }
    try:
        return zenoh.open(_config(connect, role))
    except zenoh.ZError:
        return None


def _keep_connected(
    transport: ZenohTransport,
    connect: Callable[[], zenoh.Session | None],
    ended: threading.Event,
) -> None:
    """Replace a session that has lost its hub by a new one.

    Zenoh would connect again by itself, under the same identity. While the hub still takes the old
    connection for alive, it then reads the new one's short numbers for keys by the old one's table:
    for minutes messages came to readers of other keys, or to none.
    """
    while not ended.wait(LOOK_S):
        if not transport.has_lost_hub():
            continue
        transport.close()
        while (session := connect()) is None:
            if ended.wait(RETRY_S):
                return
        transport.renew(session)


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


def _config(
    part: Mapping[str, object], name: str, transport: Mapping[str, Any] | None = None
) -> zenoh.Config:
    own = transport or {}
    common = {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            **own,
            "link": {**own.get("link", {}), "tx": {"lease": LEASE_MS, "keep_alive": 4}},
            "shared_memory": {"enabled": False},
        },
        "metadata": {"name": name},
    }
    return zenoh.Config.from_json5(json.dumps({**part, **common}))
