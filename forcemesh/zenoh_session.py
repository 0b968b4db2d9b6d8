"""Zenoh transport of the bus between processes. The only file that imports zenoh.

One hub (a Zenoh router), with every process its client at an explicit endpoint; no multicast, no
gossip, no shared memory. Streams drop when congested and readers keep only the newest message, so a
slow reader never blocks a publisher.
"""

import json
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial

import zenoh

from forcemesh.clock import NS_PER_S, MonotonicClock, wait_until
from forcemesh.connection import Reachable
from forcemesh.errors import BusError, NoHubError
from forcemesh.identity import HUB, common_name
from forcemesh.topics import CLIENT, SELF_TEST, Qos
from forcemesh.zenoh_settings import MOST_SESSIONS, client_settings, endpoint_of, security_of

MAX_WAITING_REQUESTS = 16
SELF_TEST_WITHIN_S = 1.0  # until one session is announced to the other
SELF_TEST_WAIT_S = 0.25  # a message takes only milliseconds
SELF_TEST_POLL_S = 0.01
LONGEST_END_S = 1.0  # a receiver thread ends within a millisecond of its session
PUTS_KEPT = 2048  # window of the longest put: more than a busy process puts in a second


@contextmanager
def open_session(cell: Reachable, role: str, patience_s: float) -> Iterator["ZenohTransport"]:
    """Connect a role to its cell's hub; close the session in any case.

    Raises:
        BusError: No reply from the hub within `patience_s`; the endpoint is open to unauthorised
            clients; the role has no certificate; the peer is not this cell's hub; or the hub
            enforces no access control.
    """
    endpoint = endpoint_of(cell)
    security = security_of(cell, role, endpoint)
    session = _connect(endpoint, role, patience_s, security)
    with closing(ZenohTransport(session)) as transport:
        if security:
            _refuse_a_false_hub(session, cell, endpoint)
        if security and role != CLIENT:
            with _connect(endpoint, role, patience_s, security) as other:
                _refuse_hub_without_acl(session, other, f"{cell.cell}/{SELF_TEST}", endpoint)
        yield transport


@contextmanager
def open_router(settings: Mapping[str, object], endpoint: str) -> Iterator["ZenohTransport"]:
    """Open a hub: a Zenoh router that listens on an endpoint.

    Raises:
        BusError: The endpoint is in use.
    """
    config = zenoh.Config.from_json5(json.dumps(settings))
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(f"cannot listen on {endpoint}: is another hub running there?") from error
    with closing(ZenohTransport(session)) as transport:
        yield transport


def log_refusals() -> None:
    """Make Zenoh log denials and warnings to standard output; once per process."""
    zenoh.init_log_from_env_or("warn,zenoh_link_tls=debug,zenoh::net::routing::interceptor=trace")


def _refuse_hub_without_acl(
    receiver: zenoh.Session, sender: zenoh.Session, key: str, endpoint: str
) -> None:
    """Self-test of access control: publish on a key that the ACL denies to every role.

    Receiving it means that the hub enforces no ACL. Without a match it is inconclusive.
    """
    subscriber = receiver.declare_subscriber(key, zenoh.handlers.RingChannel(1))
    publisher = sender.declare_publisher(key)

    def is_matched() -> bool:
        return bool(publisher.matching_status.matching)  # type: ignore[attr-defined]

    def is_received() -> bool:
        return subscriber.try_recv() is not None

    wait = partial(wait_until, MonotonicClock(), poll_s=SELF_TEST_POLL_S)
    if not wait(is_matched, within_s=SELF_TEST_WITHIN_S):
        return
    publisher.put(b"self-test of access control")
    if wait(is_received, within_s=SELF_TEST_WAIT_S):
        raise BusError(
            f"refused: the hub at {endpoint} accepts every message: it runs without the "
            "access control of this cell; start it with `python -m services.hub`"
        )
    subscriber.undeclare()


def _refuse_a_false_hub(session: zenoh.Session, cell: Reachable, endpoint: str) -> None:
    """Refuse a hub with another name's certificate, although TLS accepts it as a server's.

    Detects certificates of an older forcemesh, and the hub of another cell of the same authority.
    """
    expected = common_name(HUB, cell.cell)
    shown = {link.auth_identifier for link in session.info.links()} - {None}
    if shown and expected not in shown:
        raise BusError(
            f"refused: the server at {endpoint} shows the certificate of "
            f"{', '.join(sorted(map(str, shown)))}, but the hub of this cell shows {expected}"
        )


def _connect(
    endpoint: str, role: str, patience_s: float, security: Mapping[str, object]
) -> zenoh.Session:
    config = json.dumps(client_settings(endpoint, role, security))
    refusing = ", or it refuses this certificate: see its log" if security else ""
    give_up = time.monotonic() + patience_s
    while True:
        try:
            return zenoh.open(zenoh.Config.from_json5(config))
        except zenoh.ZError as error:
            if time.monotonic() >= give_up:
                raise NoHubError(
                    f"no hub at {endpoint}{refusing}: is the cell up? Or end other clients: "
                    f"a hub serves at most {MOST_SESSIONS} processes at once"
                ) from error
            time.sleep(0.1)


class ZenohSource:
    """Subscriber with a ring channel of one or more samples."""

    def __init__(
        self, subscriber: "zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]", room: int
    ) -> None:
        """Read from an open subscriber whose channel has room for some samples."""
        self._subscriber, self._room = subscriber, room
        self._receiver: ReceiverThread | None = None

    def close(self) -> None:
        """Wait for the receiver thread to end; the session has been closed."""
        if self._receiver is not None:
            self._receiver.end()

    def take(self) -> bytes | None:
        """Return the next payload not yet taken, None when there is none."""
        if self._receiver is not None:
            return self._receiver.take()
        sample = self._subscriber.try_recv()
        return None if sample is None else sample.payload.to_bytes()

    def wait(self, timeout_s: float) -> None:
        """Sleep until a message arrives, at most for a time [s]."""
        if self._receiver is None:  # only waiting needs a thread
            self._receiver = ReceiverThread(self._subscriber.recv, self._room)
        self._receiver.wait(timeout_s)


class ReceiverThread:
    """Receiver thread that keeps the newest samples: waiting costs a third of polling."""

    def __init__(self, receive: Callable[[], zenoh.Sample], room: int = 1) -> None:
        """Receive until the session is closed."""
        # A lock that is free while a sample waits. An Event hands the interpreter over several
        # times for each sample: 10 % of a core and 3 ms of the p99 of a chain of four processes.
        self._nothing = threading.Lock()
        self._nothing.acquire()
        self._receive = receive
        self._newest: deque[zenoh.Sample] = deque(maxlen=room)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Join the thread: if it is still in Zenoh when Python exits, the process aborts."""
        self._thread.join(LONGEST_END_S)

    def wait(self, timeout_s: float) -> None:
        """Sleep until a sample arrives, at most for a time [s]."""
        self._nothing.acquire(timeout=max(0.0, timeout_s))

    def take(self) -> bytes | None:
        """Return the next payload once."""
        # First: a concurrent arrival causes a spurious wake-up, never a lost one.
        self._nothing.acquire(blocking=False)
        try:
            return self._newest.popleft().payload.to_bytes()
        except IndexError:
            return None

    def _listen(self) -> None:
        with suppress(zenoh.ZError):
            while True:
                self._newest.append(self._receive())
                if self._nothing.locked():  # only this thread releases it
                    self._nothing.release()


@dataclass(slots=True)
class ZenohCall:
    """A pending query."""

    query: zenoh.Query
    data: bytes

    def answer(self, data: bytes) -> None:
        """Reply and close the query; a client that has left is not an error."""
        with suppress(zenoh.ZError), self.query:
            self.query.reply(self.query.key_expr, data)


@dataclass(slots=True)
class ZenohCalls:
    """Queryable whose queries the service takes in its own loop."""

    queryable: "zenoh.Queryable[zenoh.handlers.Handler[zenoh.Query]]"

    def take(self) -> ZenohCall | None:
        """Return the oldest query not yet taken."""
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
        self._gathered: list[Callable[[], None]] | None = None

    def close(self) -> None:
        """Close the session and join its receiver threads."""
        with suppress(zenoh.ZError):
            self._session.close()
        for source in self._sources:
            source.close()

    def links_by_name(self) -> Counter[str]:
        """Return the number of open links of each certificate name."""
        shown = (link.auth_identifier for link in self._session.info.links())
        return Counter(name for name in shown if name)

    def longest_put_s(self, since_ns: int) -> float:
        """Return the duration of the longest put that began after a monotonic time [s]."""
        return max((took for at, took in list(self._puts) if at >= since_ns), default=0) / NS_PER_S

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that publishes bytes on a key; it never blocks on a slow reader."""
        urgent = qos == "stream"
        publisher = self._session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME if urgent else zenoh.Priority.DATA,
            express=urgent,
        )

        def send(data: bytes) -> None:
            began_ns = time.monotonic_ns()
            # A session without a hub drops the message: readers detect it as stale.
            with suppress(zenoh.ZError):
                publisher.put(data)
            self._puts.append((began_ns, time.monotonic_ns() - began_ns))

        def put(data: bytes) -> None:
            if self._gathered is None:
                send(data)
            else:
                self._gathered.append(partial(send, data))

        return put

    @contextmanager
    def gathered(self) -> Iterator[None]:
        """Send what is published during the block at its end; of a block within, at that one's end.

        Hub and readers then wake once for all of it. Only for a process that publishes from one
        thread.
        """
        waiting: list[Callable[[], None]] = []
        outer, self._gathered = self._gathered, waiting
        try:
            yield
        finally:
            self._gathered = outer
            for send in waiting:
                send()

    def subscribe(self, key: str, room: int = 1) -> ZenohSource:
        """Return a source of the newest `room` payloads of a key, in order."""
        subscriber = self._session.declare_subscriber(key, zenoh.handlers.RingChannel(room))
        self._sources.append(ZenohSource(subscriber, room))
        return self._sources[-1]

    def serve(self, key: str) -> ZenohCalls:
        """Return the source of the queries of a key."""
        return ZenohCalls(
            self._session.declare_queryable(key, zenoh.handlers.RingChannel(MAX_WAITING_REQUESTS))
        )

    def ask(self, key: str, data: bytes, timeout_s: float) -> bytes | None:
        """Send a query, repeat it while no process serves the key, until the timeout.

        A query without a queryable returns empty at once and was not executed, so a repetition is
        safe; a query that was taken but not answered in time is not repeated.
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
