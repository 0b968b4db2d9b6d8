"""The bus as services see it: publishers, readers that judge, inboxes; checked against the table.

What carries the bytes is a `Transport`: Zenoh between processes (`common.bus`), or memory inside
one process on a virtual clock (`common.memory`). Services cannot tell which.
"""

import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from common.clock import NS_PER_S, Clock
from common.codec import Header, decode, decode_record, encode, encode_record
from common.errors import BusError, MessageError
from common.faults import refusal
from common.messages import Message, Record, Reply
from common.topics import CLIENT, Qos, Request, Topic

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Record)

LONGEST_FAULT = 400  # leaves room for what the next service says before it


class Source(Protocol):
    """Newest bytes of one key; older ones that nobody took are gone."""

    def take(self) -> bytes | None:
        """Return the newest bytes that were not taken yet, or None."""


class Call(Protocol):
    """One request waiting for its answer."""

    data: bytes

    def answer(self, data: bytes) -> None:
        """Send the answer."""


class CallSource(Protocol):
    """Requests of one key in the order of their arrival."""

    def take(self) -> Call | None:
        """Return the oldest request that was not taken yet, or None."""


class Transport(Protocol):
    """What carries bytes by key."""

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that puts bytes on a key."""

    def subscribe(self, key: str) -> Source:
        """Return a source of the newest bytes on a key."""

    def serve(self, key: str) -> CallSource:
        """Return the requests that come in on a key."""

    def ask(self, key: str, data: bytes, timeout_s: float) -> bytes | None:
        """Return the answer to a request, or None when nobody answered in time."""


class Timing(Protocol):
    """How often topics come and when they are stale: the cell file."""

    def stale_after_s(self, topic: Topic[Any]) -> float:
        """Return the age [s] from which on a topic is stale."""


class Origin(NamedTuple):
    """The sensor sample behind a message."""

    stamp_ns: int
    seq: int


@dataclass(frozen=True, slots=True)
class Reading(Generic[M]):
    """What a reader knows: the last message, and what is wrong with it, if anything."""

    message: M | None
    header: Header | None
    age_s: float
    fault: str  # empty when the message is present, valid and fresh
    silent: bool = False  # missing or stale: its writer is not heard
    code: str = ""  # of common/faults.py, for the fault

    @property
    def fresh(self) -> M | None:
        """The message if nothing is wrong with it."""
        return None if self.fault else self.message

    @property
    def origin(self) -> Origin | None:
        """The sensor sample behind the message."""
        if self.header is None or self.header.sensor_stamp_ns is None:
            return None
        return Origin(self.header.sensor_stamp_ns, self.header.sensor_seq or 0)


@dataclass(slots=True)
class ReadCounters:
    """What a reader dropped, and why."""

    received: int = 0
    superseded: int = 0
    undecodable: int = 0
    repeated: int = 0  # duplicate or reordered within one epoch
    retired: int = 0  # from a writer that another one has followed: two writers
    last_error: str = ""


class Reader(Generic[M]):
    """Newest message of one topic, judged on every read: missing, invalid, stale or good."""

    def __init__(self, topic: Topic[M], source: Source, clock: Clock, stale_after_s: float) -> None:
        """Wrap a source."""
        self.topic = topic
        self.stale_after_s = stale_after_s
        self.counters = ReadCounters()
        self._source = source
        self._clock = clock
        self._last: tuple[Header, M] | None = None
        self._broken: MessageError | None = None  # what came last could not be read
        self._received_ns = 0
        self._retired_epochs: set[int] = set()

    def poll(self) -> bool:
        """Take what has come in; tell whether a newer message was accepted."""
        data = self._source.take()
        if data is None:
            return False
        try:
            header, message = decode(data, self.topic.message)
        except MessageError as error:
            self.counters.undecodable += 1
            self.counters.last_error = str(error)
            self._broken = error
            return False
        return self._accept(header, message)

    def read(self, now_ns: int) -> Reading[M]:
        """Take what has come in and judge the newest message at this time."""
        self.poll()
        if self._last is None:
            fault = f"{self.topic.key} missing"
            return Reading(None, None, float("inf"), fault, silent=True, code="missing")
        header, message = self._last
        age_s = self._age_s(header, now_ns)
        code, fault = self._judge(message, age_s)
        return Reading(
            message, header, age_s, fault[:LONGEST_FAULT], silent=code == "stale", code=code
        )

    def _judge(self, message: M, age_s: float) -> tuple[str, str]:
        """Return code and text of what is wrong, both empty when nothing is."""
        if age_s > self.stale_after_s:
            age_ms, limit_ms = age_s * 1e3, self.stale_after_s * 1e3
            return "stale", f"{self.topic.key} stale: {age_ms:.0f} ms old, limit {limit_ms:.0f} ms"
        if self._broken is not None:  # not what it said before, nor zero: unknown
            return self._broken.code, f"{self.topic.key} unreadable: {self._broken}"
        if not message.valid:
            reason = message.reason or "no reason given"
            return message.code or "invalid", f"{self.topic.key} invalid: {reason}"
        return "", ""

    def _accept(self, header: Header, message: M) -> bool:
        if header.epoch in self._retired_epochs:
            self.counters.retired += 1
            return False
        if self._last is not None:
            last = self._last[0]
            if header.epoch != last.epoch:
                self._retired_epochs.add(last.epoch)
            elif header.seq <= last.seq:
                self.counters.repeated += 1
                return False
            else:
                self.counters.superseded += header.seq - last.seq - 1
        self.counters.received += 1
        self._broken = None
        self._last = (header, message)
        self._received_ns = self._clock.now_ns()
        return True

    def _age_s(self, header: Header, now_ns: int) -> float:
        """Age since arrival, and on one and the same clock also since it was written.

        The second one matters after a freeze: the newest message waiting in the channel is old.
        """
        since_ns = self._received_ns
        if header.boot == self._clock.boot:
            since_ns = min(since_ns, header.stamp_ns)
        return (now_ns - since_ns) / NS_PER_S


class Publisher(Generic[M]):
    """The one writer of a topic: stamps and numbers what it sends."""

    def __init__(
        self, topic: Topic[M], put: Callable[[bytes], None], clock: Clock, epoch: int
    ) -> None:
        """Wrap a transport's put."""
        self.topic = topic
        self.seq = 0
        self._put = put
        self._clock = clock
        self._epoch = epoch

    def put(self, message: M, origin: Origin | None = None) -> Header:
        """Send a message, with the sensor sample behind it if there is one."""
        self.seq += 1
        header = Header(
            seq=self.seq,
            epoch=self._epoch,
            boot=self._clock.boot,
            stamp_ns=self._clock.now_ns(),
            sensor_stamp_ns=None if origin is None else origin.stamp_ns,
            sensor_seq=None if origin is None else origin.seq,
        )
        self._put(encode(header, message))
        return header


@dataclass(frozen=True, slots=True)
class Incoming(Generic[Q]):
    """A request that decoded well, and the way to answer it."""

    request: Q
    call: Call

    def reply(self, reply: Reply) -> None:
        """Answer."""
        self.call.answer(encode_record(reply))


class Inbox(Generic[Q]):
    """The requests of one row of the table, for the service that serves it."""

    def __init__(self, request: Request[Q], source: CallSource) -> None:
        """Wrap a source."""
        self._request = request
        self._source = source

    def take_all(self) -> Iterator[Incoming[Q]]:
        """Yield what has come in; a request that does not decode is refused on the spot."""
        while (call := self._source.take()) is not None:
            try:
                yield Incoming(decode_record(call.data, self._request.message), call)
            except MessageError as error:
                call.answer(encode_record(refusal("malformed", str(error))))


@dataclass(slots=True)
class Bus:
    """A role's view of one cell's bus: it refuses what the table does not give to that role."""

    role: str
    cell: str
    transport: Transport
    timing: Timing
    clock: Clock
    epoch: int = field(default_factory=lambda: secrets.randbits(62))

    def playing(self, role: str) -> "Bus":
        """Return the view of another role that the same process plays."""
        return replace(self, role=role, epoch=secrets.randbits(62))

    def publisher(self, topic: Topic[M]) -> Publisher[M]:
        """Return the writer of a topic. Raise BusError unless the table names this role."""
        if topic.writer != self.role:
            raise BusError(f"{self.role} may not write {topic.key}: {topic.writer} does")
        put = self.transport.publish(f"{self.cell}/{topic.key}", topic.qos)
        return Publisher(topic, put, self.clock, self.epoch)

    def reader(self, topic: Topic[M]) -> Reader[M]:
        """Return a reader of a topic. Raise BusError unless the table names this role."""
        if self.role not in topic.readers:
            raise BusError(f"{self.role} is not a reader of {topic.key}: {topic.readers} are")
        source = self.transport.subscribe(f"{self.cell}/{topic.key}")
        return Reader(topic, source, self.clock, self.timing.stale_after_s(topic))

    def inbox(self, request: Request[Q]) -> Inbox[Q]:
        """Return the requests that this role serves."""
        if request.server != self.role:
            raise BusError(f"{self.role} does not serve {request.key}: {request.server} does")
        return Inbox(request, self.transport.serve(f"{self.cell}/{request.key}"))

    def ask(self, request: Request[Q], message: Q, timeout_s: float = 2.0) -> Reply:
        """Send a request and return the answer. Raise BusError when nobody answers."""
        if self.role != CLIENT:
            raise BusError(f"only clients send requests, {self.role} is none")
        key = f"{self.cell}/{request.key}"
        data = self.transport.ask(key, encode_record(message), timeout_s)
        if data is None:
            raise BusError(f"{request.server} did not answer {key} within {timeout_s:g} s")
        return decode_record(data, Reply)
