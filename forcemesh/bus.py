"""Bus endpoints: publishers, checked readers and inboxes, all verified against the topic table.

A `Transport` carries the bytes: Zenoh between processes (`forcemesh.zenoh_session`), or memory
inside one process on a virtual clock (`common.bus.memory_bus`). Services do not depend on which.
"""

import secrets
import threading
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar

from forcemesh.clock import Clock, wait_until
from forcemesh.codec import Envelope, Header, decode_record, encode, encode_record
from forcemesh.errors import BusError, LostError
from forcemesh.inbox import Call, CallSource, Inbox, Incoming
from forcemesh.messages import Health, Message
from forcemesh.reader import LONGEST_FAULT, Origin, Reader, Reading, Source
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.served_requests import ServedRequests, name_of_this_process
from forcemesh.topics import CLIENT, HEALTH, HELPERS, SERVED, Qos, Request, Topic

__all__ = [
    "LONGEST_FAULT",
    "Bus",
    "Call",
    "CallSource",
    "FixedReply",
    "Inbox",
    "Incoming",
    "Origin",
    "Publisher",
    "Reader",
    "Reading",
    "Source",
    "Timing",
    "Transport",
    "query_hub",
]

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Record)

HEALTH_POLL_S = 0.02
STAMPS_KEPT = 256  # of the last messages of a publisher: a minute of health


class Transport(Protocol):
    """Transport of bytes by key."""

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that publishes bytes on a key."""

    def subscribe(self, key: str, room: int = 1) -> Source:
        """Return a source of the newest `room` payloads on a key."""

    def serve(self, key: str) -> CallSource:
        """Return the source of requests on a key."""

    def gathered(self) -> AbstractContextManager[None]:
        """Send what is published during the block together, at its end."""

    def ask(self, key: str, data: bytes, timeout_s: float) -> bytes | None:
        """Return the reply to a request, or None after the timeout."""


class Timing(Protocol):
    """Stale times of topics, from the cell file."""

    def stale_after_s(self, topic: Topic[Any]) -> float:
        """Return the age [s] above which a topic is stale."""


class Publisher(Generic[M]):
    """The only publisher of a topic: adds time stamp and sequence number."""

    def __init__(
        self, topic: Topic[M], put: Callable[[bytes], None], clock: Clock, epoch: int, *, cell: str
    ) -> None:
        """Wrap the publish function of a transport."""
        self.topic = topic
        self._address = f"{cell}/{topic.key}"
        self.seq = 0
        self._put = put
        self._clock = clock
        self._epoch = epoch
        self._stamps_ns: deque[int] = deque(maxlen=STAMPS_KEPT)

    def put(self, message: M, origin: Origin | None = None, *, at_ns: int | None = None) -> Header:
        """Publish a message.

        Args:
            message: The message.
            origin: Sensor sample on which it is based.
            at_ns: Time at which its values were measured [ns]; None: now.
        """
        self.seq += 1
        header = Header(
            seq=self.seq,
            epoch=self._epoch,
            boot=self._clock.boot,
            stamp_ns=self._clock.now_ns() if at_ns is None else at_ns,
            topic=self._address,
            sensor_stamp_ns=None if origin is None else origin.stamp_ns,
            sensor_seq=None if origin is None else origin.seq,
        )
        self._put(encode(header, message))
        self._stamps_ns.append(header.stamp_ns)
        return header

    def published_ns(self, epoch: int, seq: int) -> int | None:
        """Return when a message was published [ns], None if not here or not among the last ones."""
        later = self.seq - seq
        if epoch != self._epoch or not 0 <= later < len(self._stamps_ns):
            return None
        return self._stamps_ns[-1 - later]


class FixedReply:
    """Server of a query whose reply does not change; the payload of the query is ignored."""

    def __init__(self, transport: Transport, key: str, reply: bytes) -> None:
        """Serve a key with a reply."""
        self._reply = reply
        self._calls = transport.serve(key)

    def step(self) -> None:
        """Answer the queries received since the last step."""
        while (call := self._calls.take()) is not None:
            call.answer(self._reply)


def query_hub(transport: Transport, key: str, timeout_s: float, hint: str = "") -> bytes:
    """Return the hub's fixed reply on a key. Raise LostError when it does not answer."""
    data = transport.ask(key, b"", timeout_s)
    if data is None:
        raise LostError(f"the hub did not answer {key} in {timeout_s:g} s{hint}", ("hub",))
    return data


@dataclass(slots=True)
class Bus:
    """A role's access to one cell's bus: it refuses what the topic table does not grant."""

    role: str
    cell: str
    transport: Transport
    timing: Timing
    clock: Clock
    epoch: int = field(default_factory=lambda: secrets.randbits(62))
    client: str = field(default_factory=lambda: secrets.token_hex(4))  # owner of what it starts
    _served: ServedRequests | None = field(default=None, init=False)
    _health: Publisher[Any] | None = field(default=None, init=False)
    _elsewhere: dict[str, Reader[Health]] = field(default_factory=dict, init=False)  # by server
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)

    @property
    def requests_served(self) -> int | None:
        """The number of requests served since the start, None for a role that serves none."""
        return None if self._served is None else self._served.count

    def playing(self, role: str) -> "Bus":
        """Return the access of another role of the same process."""
        return replace(self, role=role, epoch=secrets.randbits(62))

    def publisher(self, topic: Topic[M]) -> Publisher[M]:
        """Return the publisher of a topic. Raise BusError unless the table names this role."""
        if topic.writer != self.role:
            raise BusError(f"{self.role} may not write {topic.key}: {topic.writer} does")
        put = self.transport.publish(f"{self.cell}/{topic.key}", topic.qos)
        publisher = Publisher(topic, put, self.clock, self.epoch, cell=self.cell)
        if topic.key == HEALTH[self.role].key:
            self._health = publisher
        return publisher

    def reader(self, topic: Topic[M], room: int = 1) -> Reader[M]:
        """Return a reader of a topic, which reads its newest message or every one of a queue.

        Raises BusError unless the table names this role.
        """
        if self.role not in topic.readers:
            raise BusError(f"{self.role} is not a reader of {topic.key}: {topic.readers} are")
        source = self.transport.subscribe(f"{self.cell}/{topic.key}", room)
        stale_after_s = self.timing.stale_after_s(topic)
        return Reader(topic, source, self.clock, stale_after_s, cell=self.cell)

    def tap(self, topic: Topic[Any], room: int) -> Source:
        """Return a source of every message of a topic as bytes, in order, with a queue of `room`.

        Raises BusError unless this role is a client or helper. Messages are not checked.
        """
        if self.role not in (CLIENT, *HELPERS):
            raise BusError(f"{self.role} may not tap {topic.key}: only clients and helpers may")
        return self.transport.subscribe(f"{self.cell}/{topic.key}", room)

    def inbox(self, request: Request[Q]) -> Inbox[Q]:
        """Return the inbox of a request that this role serves."""
        if request.server != self.role:
            raise BusError(f"{self.role} does not serve {request.key}: {request.server} does")
        source = self.transport.serve(f"{self.cell}/{request.key}")
        if self._served is None:
            self._served = ServedRequests(self.publisher(SERVED[self.role]).put, self.clock)
        return Inbox(
            request, source, self.clock, cell=self.cell, served=self._served,
            status=lambda: self._health,
        )  # fmt: skip

    def ask(self, request: Request[Q], message: Q, timeout_s: float = 2.0) -> Reply:
        """Send a request and return the reply; the server executes it only within the timeout.

        A server on another clock refuses the first one, which is repeated with its newest health:
        so no request on one host, and no hold, waits for a health.

        Raises BusError after the timeout.
        """
        if self.role != CLIENT:
            raise BusError(f"only clients send requests, {self.role} is not a client")
        server, status = request.server, self._health_elsewhere(request.server)
        reply = self._ask_once(request, message, timeout_s, status)
        if reply.code != "late" or status is not None:
            return reply
        reader = self.reader(HEALTH[server])
        wait_until(self.clock, reader.poll, within_s=timeout_s, poll_s=HEALTH_POLL_S)
        status = reader.read(self.clock.now_ns()).header
        if status is None or status.boot == self.clock.boot:
            return reply
        self._elsewhere[server] = reader
        return self._ask_once(request, message, timeout_s, status)

    def _health_elsewhere(self, server: str) -> Header | None:
        """Return the newest health of a server on another clock, None on this one."""
        with self._lock:
            reader = self._elsewhere.get(server)
            return None if reader is None else reader.read(self.clock.now_ns()).header

    def _ask_once(
        self, request: Request[Q], message: Q, timeout_s: float, status: Header | None
    ) -> Reply:
        key = f"{self.cell}/{request.key}"
        envelope = Envelope(
            topic=key,
            sender=name_of_this_process(),
            client=self.client,
            boot=self.clock.boot,
            stamp_ns=self.clock.now_ns(),
            wait_s=timeout_s,
            status_epoch=0 if status is None else status.epoch,
            status_seq=0 if status is None else status.seq,
        )
        data = self.transport.ask(key, encode_record(message, envelope), timeout_s)
        if data is None:
            raise BusError(f"{request.server} did not answer {key} within {timeout_s:g} s")
        return decode_record(data, Reply)
