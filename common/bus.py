"""The bus between processes: Zenoh. The only file that imports it.

One hub (a Zenoh router) and every process its client with an explicit endpoint; no multicast, no
gossip, no shared memory. Streams drop when congested and readers keep the newest only, so that a
slow reader can never hold a writer up.
"""

import json
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, TypeAlias

import zenoh

from common.cell import Cell
from common.clock import NS_PER_S, Clock, MonotonicClock
from common.endpoints import Bus
from common.errors import BusError
from common.topics import Qos

ENDPOINT_VARIABLE = "FORCEMESH_ENDPOINT"
CONNECT_ATTEMPT_MS = 500
LEASE_MS = 500
MAX_WAITING_REQUESTS = 16
# What no honest client needs more of: the longest message of the table has less than 4 kB.
LONGEST_MESSAGE_B = 16_384
LONGEST_TRANSPORT_MESSAGE_B = 65_536  # before the hub even knows what it is
MOST_CLIENTS = 64
PUTS_KEPT = 2048  # of which the longest is reported: more than a busy process puts in a second


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
    session = _connect(endpoint_of(cell), role, patience_s)
    try:
        transport = ZenohTransport(session)
        yield Bus(role, cell.cell, transport, cell, clock or MonotonicClock())
    finally:
        with suppress(zenoh.ZError):
            session.close()


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
    connect = {
        "mode": "client",
        "connect": {
            "endpoints": [endpoint],
            "timeout_ms": CONNECT_ATTEMPT_MS,
            "exit_on_failure": True,
            "retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        },
    }
    give_up = time.monotonic() + patience_s
    while True:
        try:
            return zenoh.open(_config(connect, role))
        except zenoh.ZError as error:
            if time.monotonic() >= give_up:
                raise BusError(f"no hub at {endpoint}: is the cell up?") from error
            time.sleep(0.1)


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


Subscriber: TypeAlias = "zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]"


class ZenohSource:
    """A subscriber whose channel holds one sample."""

    def __init__(
        self, subscriber: "zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]"
    ) -> None:
        """Take from an open subscriber."""
        self._subscriber = subscriber
        self._ear: Ear | None = None

    def take(self) -> bytes | None:
        """Return the newest payload that was not taken yet."""
        if self._ear is not None:
            return self._ear.take()
        sample = self._subscriber.try_recv()
        return None if sample is None else sample.payload.to_bytes()

    def wait(self, timeout_s: float) -> None:
        """Sleep until something has come in, or the time [s] is over."""
        if self._ear is None:  # only who waits needs a thread
            self._ear = Ear(self._subscriber.recv)
        self._ear.news.wait(timeout_s)


class Ear:
    """A thread that keeps the newest sample: to wait for one costs a third of looking for it."""

    def __init__(self, receive: Callable[[], zenoh.Sample]) -> None:
        """Listen until the session is closed."""
        self.news = threading.Event()
        self._receive = receive
        self._newest: deque[zenoh.Sample] = deque(maxlen=1)
        threading.Thread(target=self._listen, daemon=True).start()

    def take(self) -> bytes | None:
        """Return the newest payload once."""
        self.news.clear()  # first: what comes in between wakes once too often, never once too few
        try:
            return self._newest.popleft().payload.to_bytes()
        except IndexError:
            return None

    def _listen(self) -> None:
        with suppress(zenoh.ZError):
            while True:
                self._newest.append(self._receive())
                self.news.set()


@dataclass(slots=True)
class ZenohCall:
    """A query that waits for its reply."""

    query: zenoh.Query
    data: bytes

    def answer(self, data: bytes) -> None:
        """Reply and let the asker go; an asker that left is no fault of ours."""
        with suppress(zenoh.ZError), self.query:
            self.query.reply(self.query.key_expr, data)


@dataclass(slots=True)
class ZenohCalls:
    """A queryable whose queries are taken in the service's own loop."""

    queryable: "zenoh.Queryable[zenoh.handlers.Handler[zenoh.Query]]"

    def take(self) -> ZenohCall | None:
        """Return the oldest query that was not taken yet."""
        query = self.queryable.try_recv()
        if query is None:
            return None
        payload = query.payload
        return ZenohCall(query, b"" if payload is None else payload.to_bytes())


class ZenohTransport:
    """One Zenoh session."""

    def __init__(self, session: zenoh.Session) -> None:
        """Use an open session; whoever opened it closes it."""
        self._session = session
        self._puts: deque[tuple[int, int]] = deque(maxlen=PUTS_KEPT)  # begin, duration [ns]

    def longest_put_s(self, since_ns: int) -> float:
        """Return how long the longest put took that began after a monotonic time [s]."""
        return max((took for at, took in list(self._puts) if at >= since_ns), default=0) / NS_PER_S

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that puts bytes on a key; it never blocks on a slow reader."""
        urgent = qos == "stream"
        publisher = self._session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME if urgent else zenoh.Priority.DATA,
            express=urgent,
        )

        def put(data: bytes) -> None:
            began_ns = time.monotonic_ns()
            # A session that has lost its hub drops what is put: readers see staleness.
            with suppress(zenoh.ZError):
                publisher.put(data)
            self._puts.append((began_ns, time.monotonic_ns() - began_ns))

        return put

    def subscribe(self, key: str) -> ZenohSource:
        """Return the newest payload of a key."""
        return ZenohSource(self._session.declare_subscriber(key, zenoh.handlers.RingChannel(1)))

    def serve(self, key: str) -> ZenohCalls:
        """Return the queries of a key."""
        return ZenohCalls(
            self._session.declare_queryable(key, zenoh.handlers.RingChannel(MAX_WAITING_REQUESTS))
        )

    def ask(self, key: str, data: bytes, timeout_s: float) -> bytes | None:
        """Ask, and ask again while nobody is there, until the time is up.

        A query that found nobody comes back empty at once and was not taken by anyone, so asking
        again is safe; one that was taken and not answered in time is not repeated.
        """
        give_up = time.monotonic() + timeout_s
        while (left_s := give_up - time.monotonic()) > 0.0:
            replies = list(self._session.get(key, payload=data, timeout=left_s))
            for reply in replies:
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
            if replies:
                return None
            time.sleep(0.05)
        return None
