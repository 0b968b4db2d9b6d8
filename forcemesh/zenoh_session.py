"""The bus between processes: Zenoh. The only file that imports it.

One hub (a Zenoh router) and every process its client with an explicit endpoint; no multicast, no
gossip, no shared memory. Streams drop when congested and readers keep the newest only, so that a
slow reader can never hold a writer up.
"""

import json
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TypeAlias

import zenoh

from forcemesh.clock import NS_PER_S
from forcemesh.connection import Reachable
from forcemesh.errors import BusError
from forcemesh.identity import HUB, common_name
from forcemesh.topics import CLIENT, SELF_TEST, Qos
from forcemesh.zenoh_settings import (
    client_settings,
    endpoint_of,
    security_of,
)

MAX_WAITING_REQUESTS = 16
SELF_TEST_WITHIN_S = 1.0  # until the hub has told the one session of the other
SELF_TEST_WAIT_S = 0.25  # what gets through is there after milliseconds
LONGEST_END_S = 1.0  # a thread that listens ends within a millisecond of its session
PUTS_KEPT = 2048  # of which the longest is reported: more than a busy process puts in a second


@contextmanager
def open_session(cell: Reachable, role: str, patience_s: float) -> Iterator["ZenohTransport"]:
    """Connect a role to its cell's hub; close the session in any case.

    Raises:
        BusError: The hub did not answer within `patience_s`; the way to it is open to strangers;
            there is no certificate for the role; what answers is not this cell's hub; or the hub
            let it say what nobody may say.
    """
    endpoint = endpoint_of(cell)
    security = security_of(cell, role, endpoint)
    session = _connect(endpoint, role, patience_s, security)
    transport = ZenohTransport(session)
    try:
        if security:
            _refuse_a_false_hub(session, cell, endpoint)
        if security and role != CLIENT:
            with _connect(endpoint, role, patience_s, security) as other:
                _refuse_an_open_hub(session, other, f"{cell.cell}/{SELF_TEST}", endpoint)
        yield transport
    finally:
        transport.close()


@contextmanager
def open_router(settings: Mapping[str, object], endpoint: str) -> Iterator["ZenohTransport"]:
    """Be a hub: a Zenoh router that listens on an endpoint.

    Raises:
        BusError: The endpoint cannot be listened on.
    """
    config = zenoh.Config.from_json5(json.dumps(settings))
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(f"cannot listen on {endpoint}: is another hub running there?") from error
    transport = ZenohTransport(session)
    try:
        yield transport
    finally:
        transport.close()


def log_refusals() -> None:
    """Let Zenoh say on standard output what it refuses, and all warnings; once in a process."""
    zenoh.init_log_from_env_or("warn,zenoh_link_tls=debug,zenoh::net::routing::interceptor=trace")


def _refuse_an_open_hub(ear: zenoh.Session, mouth: zenoh.Session, key: str, endpoint: str) -> None:
    """Try to say what nobody may say: whoever is heard is on a hub that keeps nobody from anything.

    It cannot tell when the hub does not even say that there is a listener; then it lets it be.
    """
    heard = ear.declare_subscriber(key, zenoh.handlers.RingChannel(1))
    said = mouth.declare_publisher(key)
    give_up = time.monotonic() + SELF_TEST_WITHIN_S
    while not said.matching_status.matching:  # type: ignore[attr-defined]
        if time.monotonic() >= give_up:
            return
        time.sleep(0.01)
    said.put(b"nobody may say this")
    give_up = time.monotonic() + SELF_TEST_WAIT_S
    while time.monotonic() < give_up:
        if heard.try_recv() is not None:
            raise BusError(
                f"refused: the hub at {endpoint} lets anybody say anything: it runs without the "
                "access control of this cell; start it with `python -m services.hub`"
            )
        time.sleep(0.01)
    heard.undeclare()


def _refuse_a_false_hub(session: zenoh.Session, cell: Reachable, endpoint: str) -> None:
    """Refuse a hub that shows another name's certificate, though TLS would take it from a server.

    Certificates of an older forcemesh, and the hub of another cell under the same authority.
    """
    wanted = common_name(HUB, cell.cell)
    shown = {link.auth_identifier for link in session.info.links()} - {None}
    if shown and wanted not in shown:
        raise BusError(
            f"refused: what answers at {endpoint} shows the certificate of "
            f"{', '.join(sorted(map(str, shown)))}, and the hub of this cell shows {wanted}"
        )


def _connect(
    endpoint: str, role: str, patience_s: float, security: Mapping[str, object]
) -> zenoh.Session:
    config = json.dumps(client_settings(endpoint, role, security))
    refusing = ", or it refuses this certificate: its log says why" if security else ""
    give_up = time.monotonic() + patience_s
    while True:
        try:
            return zenoh.open(zenoh.Config.from_json5(config))
        except zenoh.ZError as error:
            if time.monotonic() >= give_up:
                raise BusError(f"no hub at {endpoint}{refusing}: is the cell up?") from error
            time.sleep(0.1)


Subscriber: TypeAlias = "zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]"


class ZenohSource:
    """A subscriber whose channel holds one sample, or as many as it has room for."""

    def __init__(
        self, subscriber: "zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]"
    ) -> None:
        """Take from an open subscriber."""
        self._subscriber = subscriber
        self._ear: Ear | None = None

    def close(self) -> None:
        """Wait for the thread that listens to end; the session has been closed."""
        if self._ear is not None:
            self._ear.end()

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
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Wait for the thread: one that is still in Zenoh when Python ends aborts the process."""
        self._thread.join(LONGEST_END_S)

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
        """Use an open session."""
        self._session = session
        self._sources: list[ZenohSource] = []
        self._puts: deque[tuple[int, int]] = deque(maxlen=PUTS_KEPT)  # begin, duration [ns]

    def close(self) -> None:
        """Close the session, and wait for the threads that listen to it."""
        with suppress(zenoh.ZError):
            self._session.close()
        for source in self._sources:
            source.close()

    def links_by_name(self) -> Counter[str]:
        """Return how many links each certificate has open here, by its name."""
        shown = (link.auth_identifier for link in self._session.info.links())
        return Counter(name for name in shown if name)

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

    def subscribe(self, key: str, room: int = 1) -> ZenohSource:
        """Return the newest payload of a key, or the newest `room` of them in their order."""
        subscriber = self._session.declare_subscriber(key, zenoh.handlers.RingChannel(room))
        self._sources.append(ZenohSource(subscriber))
        return self._sources[-1]

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
