"""Bytes by key over Zenoh, in one session after another: what is declared outlives a session."""

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol, TypeVar

import zenoh

from common.clock import NS_PER_S
from common.topics import Qos

EVENTS_KEPT = 16
MAX_WAITING_REQUESTS = 16
PUTS_KEPT = 2048  # of which the longest is reported: more than a busy process puts in a second


class Declared(Protocol):
    """Something that a session knows of, and a new session has to be told again."""

    def declare(self, session: zenoh.Session) -> None:
        """Belong to this session from now on."""


class ZenohSource:
    """A subscriber whose channel holds one sample."""

    def __init__(self, key: str) -> None:
        """Belong to no session yet."""
        self._key = key
        self._subscriber: zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]] | None = None

    def declare(self, session: zenoh.Session) -> None:
        """Subscribe."""
        self._subscriber = session.declare_subscriber(self._key, zenoh.handlers.RingChannel(1))

    def take(self) -> bytes | None:
        """Return the newest payload that was not taken yet; none while the hub is lost."""
        if self._subscriber is None:
            return None
        with suppress(zenoh.ZError):
            if (sample := self._subscriber.try_recv()) is not None:
                return sample.payload.to_bytes()
        return None


@dataclass(slots=True)
class ZenohCall:
    """A query that waits for its reply."""

    query: zenoh.Query
    data: bytes

    def answer(self, data: bytes) -> None:
        """Reply and let the asker go; an asker that left is no fault of ours."""
        with suppress(zenoh.ZError), self.query:
            self.query.reply(self.query.key_expr, data)


class ZenohCalls:
    """A queryable whose queries are taken in the service's own loop."""

    def __init__(self, key: str) -> None:
        """Belong to no session yet."""
        self._key = key
        self._queryable: zenoh.Queryable[zenoh.handlers.Handler[zenoh.Query]] | None = None

    def declare(self, session: zenoh.Session) -> None:
        """Begin to answer."""
        self._queryable = session.declare_queryable(
            self._key, zenoh.handlers.RingChannel(MAX_WAITING_REQUESTS)
        )

    def take(self) -> ZenohCall | None:
        """Return the oldest query that was not taken yet; none while the hub is lost."""
        if self._queryable is None:
            return None
        with suppress(zenoh.ZError):
            if (query := self._queryable.try_recv()) is not None:
                return ZenohCall(query, b"" if query.payload is None else query.payload.to_bytes())
        return None


class ZenohPut:
    """A publisher; it never blocks on a slow reader."""

    def __init__(self, key: str, qos: Qos, puts: deque[tuple[int, int]]) -> None:
        """Belong to no session yet; note in `puts` when each put began, and its duration [ns]."""
        self._key, self._urgent, self._puts = key, qos == "stream", puts
        self._publisher: zenoh.Publisher | None = None

    def declare(self, session: zenoh.Session) -> None:
        """Publish."""
        self._publisher = session.declare_publisher(
            self._key,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME if self._urgent else zenoh.Priority.DATA,
            express=self._urgent,
        )

    def put(self, data: bytes) -> None:
        """Send. A session that has lost its hub drops what is put: readers see staleness."""
        began_ns = time.monotonic_ns()
        if self._publisher is not None:
            with suppress(zenoh.ZError):
                self._publisher.put(data)
        self._puts.append((began_ns, time.monotonic_ns() - began_ns))


D = TypeVar("D", bound=Declared)


class ZenohTransport:
    """One Zenoh session after another."""

    def __init__(self, session: zenoh.Session) -> None:
        """Use an open session."""
        self._declared: list[Declared] = []
        self._lock = threading.RLock()  # of what is declared, and in which session
        self._puts: deque[tuple[int, int]] = deque(maxlen=PUTS_KEPT)  # begin, duration [ns]
        self.renew(session)

    @property
    def identity(self) -> str:
        """Who the hub takes this session for."""
        return str(self._session.zid())

    def renew(self, session: zenoh.Session) -> None:
        """Go on with another session; all that was declared is declared in it."""
        with self._lock:
            self._events = session.info.declare_transport_events_listener(
                zenoh.handlers.FifoChannel(EVENTS_KEPT)
            )
            self._session = session
            with suppress(zenoh.ZError):  # lost again already: the next one will do
                for each in self._declared:
                    each.declare(session)

    def has_lost_hub(self) -> bool:
        """Tell whether the connection has ended since the session was opened, be it back or not."""
        with suppress(zenoh.ZError):
            while (event := self._events.try_recv()) is not None:
                if event.kind == zenoh.SampleKind.DELETE:
                    return True
        return False

    def close(self) -> None:
        """Close the session."""
        with suppress(zenoh.ZError):
            self._session.close()

    def longest_put_s(self, since_ns: int) -> float:
        """Return how long the longest put took that began after a monotonic time [s]."""
        return max((took for at, took in list(self._puts) if at >= since_ns), default=0) / NS_PER_S

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that puts bytes on a key; it never blocks on a slow reader."""
        return self._declare(ZenohPut(key, qos, self._puts)).put

    def subscribe(self, key: str) -> ZenohSource:
        """Return the newest payload of a key."""
        return self._declare(ZenohSource(key))

    def serve(self, key: str) -> ZenohCalls:
        """Return the queries of a key."""
        return self._declare(ZenohCalls(key))

    def ask(self, key: str, data: bytes, timeout_s: float) -> bytes | None:
        """Ask, and ask again while nobody is there, until the time is up.

        A query that found nobody comes back empty at once and was not taken by anyone, so asking
        again is safe; one that was taken and not answered in time is not repeated.
        """
        give_up = time.monotonic() + timeout_s
        while (left_s := give_up - time.monotonic()) > 0.0:
            replies: list[zenoh.Reply] = []
            with suppress(zenoh.ZError):  # the hub is lost: it may be back in time
                replies = list(self._session.get(key, payload=data, timeout=left_s))
            for reply in replies:
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
            if replies:
                return None
            time.sleep(0.05)
        return None

    def _declare(self, thing: D) -> D:
        with self._lock:
            self._declared.append(thing)
            with suppress(zenoh.ZError):
                thing.declare(self._session)
        return thing
