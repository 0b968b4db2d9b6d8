"""Bus endpoints: publishers, checked readers and inboxes, all verified against the topic table.

A `Transport` carries the bytes: Zenoh between processes (`forcemesh.zenoh_session`), or memory
inside one process on a virtual clock (`common.bus.memory_bus`). Services do not depend on which.
"""

import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar

from forcemesh.clock import Clock
from forcemesh.codec import Header, decode_record, encode, encode_record
from forcemesh.errors import BusError, LostError, MessageError
from forcemesh.faults import refusal
from forcemesh.messages import Message
from forcemesh.reader import LONGEST_FAULT, Origin, Reader, Reading, Source
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.served_requests import ServedRequests, name_of_this_process
from forcemesh.topics import CLIENT, HELPERS, SERVED, Qos, Request, Topic

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

MOST_AT_ONCE = 4  # requests of one kind in one step


class Call(Protocol):
    """One pending request."""

    data: bytes

    def answer(self, data: bytes) -> None:
        """Send the answer."""


class CallSource(Protocol):
    """Requests of one key in the order of their arrival."""

    def take(self) -> Call | None:
        """Return the oldest request not yet taken, or None."""


class Transport(Protocol):
    """Transport of bytes by key."""

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that publishes bytes on a key."""

    def subscribe(self, key: str, room: int = 1) -> Source:
        """Return a source of the newest `room` payloads on a key."""

    def serve(self, key: str) -> CallSource:
        """Return the source of requests on a key."""

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

    def put(self, message: M, origin: Origin | None = None) -> Header:
        """Publish a message, with the sensor sample it is based on, if any."""
        self.seq += 1
        header = Header(
            seq=self.seq,
            epoch=self._epoch,
            boot=self._clock.boot,
            stamp_ns=self._clock.now_ns(),
            topic=self._address,
            sensor_stamp_ns=None if origin is None else origin.stamp_ns,
            sensor_seq=None if origin is None else origin.seq,
        )
        self._put(encode(header, message))
        return header


@dataclass(frozen=True, slots=True)
class Incoming(Generic[Q]):
    """A received request, with its reply function."""

    request: Q
    call: Call
    fault: str = ""  # why it could not be decoded, if it is served anyway
    served: Callable[[Reply], None] = lambda _: None  # publishes it with its reply

    def reply(self, reply: Reply) -> None:
        """Send the reply; for a request that could not be decoded, add the decoding error."""
        if self.fault:
            text = f"{reply.text}; the request itself cannot be decoded: {self.fault}"
            refused_reply = refusal("malformed", text)
            reply = refused_reply.replaced(accepted=reply.accepted)
        self.call.answer(encode_record(reply))
        self.served(reply)


class Inbox(Generic[Q]):
    """The requests of one row of the table, for the service that serves it."""

    def __init__(
        self,
        request: Request[Q],
        source: CallSource,
        *,
        cell: str,
        served: ServedRequests | None = None,
    ) -> None:
        """Wrap the source of one request of a cell; `served` publishes each with its reply."""
        self._request = request
        self._served = served
        self._address = f"{cell}/{request.key}"
        self._source = source

    def take_all(self) -> Iterator[Incoming[Q]]:
        """Yield received requests; refuse a request that does not decode.

        Exception: a hold is served anyway, and its reply reports the decoding error.

        At most MOST_AT_ONCE per step, so that a flood of requests cannot block a control loop. The
        rest waits for the next step; the source drops the excess.
        """
        for _ in range(MOST_AT_ONCE):
            if (call := self._source.take()) is None:
                return
            request: Q | None
            try:
                request, fault = decode_record(call.data, self._request.message, self._address), ""
            except MessageError as error:
                request, fault = self._request.unreadable, str(error)
            served = self._publisher_of(call.data, None if fault else request, fault)
            if request is None:
                reply = refusal("malformed", fault)
                call.answer(encode_record(reply))
                served(reply)
            else:
                yield Incoming(request, call, fault, served)

    def _publisher_of(self, data: bytes, request: Q | None, fault: str) -> Callable[[Reply], None]:
        """Return the function that publishes a request with its reply."""
        if self._served is None:
            return lambda _: None
        return self._served.taken(self._request.key, data, request, fault)


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
    _served: ServedRequests | None = field(default=None, init=False)

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
        return Publisher(topic, put, self.clock, self.epoch, cell=self.cell)

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
        return Inbox(request, source, cell=self.cell, served=self._served)

    def ask(self, request: Request[Q], message: Q, timeout_s: float = 2.0) -> Reply:
        """Send a request and return the reply. Raise BusError after the timeout."""
        if self.role != CLIENT:
            raise BusError(f"only clients send requests, {self.role} is not a client")
        key = f"{self.cell}/{request.key}"
        data = self.transport.ask(
            key, encode_record(message, key, name_of_this_process()), timeout_s
        )
        if data is None:
            raise BusError(f"{request.server} did not answer {key} within {timeout_s:g} s")
        return decode_record(data, Reply)
