"""Inbox of a request: decodes, judges the age, refuses or passes on, and publishes the reply.

A client waits for its reply only for a time. After that a request is void: a server that was frozen
must not switch or move anything for it. Requests that stop motion are exempt: they are executed
at any age, even when they cannot be decoded.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from forcemesh.clock import NS_PER_S, Clock
from forcemesh.codec import (
    SHORTEST_WAIT_S,
    Envelope,
    decode_envelope,
    decode_record,
    encode_record,
)
from forcemesh.errors import MessageError
from forcemesh.faults import refusal
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.served_requests import ServedRequests
from forcemesh.topics import Request

Q = TypeVar("Q", bound=Record)

MOST_AT_ONCE = 4  # requests of one kind in one step
ARRIVED_S = 0.1  # after a gap of the loop: what the network still held has arrived by then


class Call(Protocol):
    """One pending request."""

    data: bytes

    def answer(self, data: bytes) -> None:
        """Send the answer."""


class CallSource(Protocol):
    """Requests of one key in the order of their arrival."""

    def take(self) -> Call | None:
        """Return the oldest request not yet taken, or None."""


class StatusLog(Protocol):
    """Times at which a server published its health."""

    def published_ns(self, epoch: int, seq: int) -> int | None:
        """Return the time of publication of a message [ns], None if it is not known."""


@dataclass(frozen=True, slots=True)
class Incoming(Generic[Q]):
    """A received request, with its reply function."""

    request: Q
    call: Call
    envelope: Envelope
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
        clock: Clock,
        *,
        cell: str,
        served: ServedRequests,
        status: Callable[[], StatusLog | None],
    ) -> None:
        """Wrap the source of one request of a cell.

        Args:
            request: Row of the table.
            source: Of the requests.
            clock: Of the server.
            cell: Name of the cell.
            served: Publishes each request with its reply.
            status: The server's health as published, None before the first one.
        """
        self._request = request
        self._served = served
        self._address = f"{cell}/{request.key}"
        self._source = source
        self._clock, self._status = clock, status
        self._taken_ns = clock.now_ns()  # the last time
        self._gap_s, self._void_until_ns = 0.0, 0

    def take_all(self) -> Iterator[Incoming[Q]]:
        """Yield received requests; refuse those that are late or do not decode.

        Exception: a request that stops motion is served anyway, and its reply reports the decoding
        error.

        At most MOST_AT_ONCE per step, so that a flood of requests cannot block a control loop. The
        rest waits for the next step; the source drops the excess.
        """
        now_ns = self._clock.now_ns()
        gap_s, self._taken_ns = (now_ns - self._taken_ns) / NS_PER_S, now_ns
        if gap_s > SHORTEST_WAIT_S:  # this process was frozen, or its loop was blocked
            self._gap_s, self._void_until_ns = gap_s, now_ns + round(ARRIVED_S * NS_PER_S)
        for _ in range(MOST_AT_ONCE):
            if (call := self._source.take()) is None:
                return
            envelope, request, fault = self._decoded(call.data)
            age_s = self._age_s(envelope, now_ns)
            served = self._served.taken(
                self._request.key, call.data, None if fault else request,
                fault=fault, envelope=envelope, age_s=age_s,
            )  # fmt: skip
            reply = refusal("malformed", fault) if request is None else None
            if self._request.unreadable is None:
                reply = reply or self._late(envelope, age_s, now_ns)
            if reply is None and request is not None:
                yield Incoming(request, call, envelope, fault, served)
            elif reply is not None:
                call.answer(encode_record(reply))
                served(reply)

    def _decoded(self, data: bytes) -> tuple[Envelope, Q | None, str]:
        """Return envelope, request, and why one of them cannot be decoded."""
        envelope = Envelope()
        try:
            envelope = decode_envelope(data, self._address)
            return envelope, decode_record(data, self._request.message), ""
        except MessageError as error:
            return envelope, self._request.unreadable, str(error)

    def _age_s(self, envelope: Envelope, now_ns: int) -> float | None:
        """Return the age of a request [s], at most, None when it is unknown.

        From another clock: the age of the newest status of this server that its client received.
        """
        sent_ns: int | None = envelope.stamp_ns
        if envelope.boot != self._clock.boot:
            status = self._status()
            sent_ns = (
                None
                if status is None
                else status.published_ns(envelope.status_epoch, envelope.status_seq)
            )
        # A stamp of the future is as wrong as one of the past.
        return None if sent_ns is None else abs(now_ns - sent_ns) / NS_PER_S

    def _late(self, envelope: Envelope, age_s: float | None, now_ns: int) -> Reply | None:
        """Return why a request is no longer executed, None when it is."""
        server, wait_s = self._request.server, envelope.wait_s
        if now_ns < self._void_until_ns:
            text = f"the {server} was stalled for {self._gap_s:.3g} s: what waited is not executed"
            return refusal("late", text, value=self._gap_s, limit=SHORTEST_WAIT_S)
        if not envelope.boot:  # of unknown age: a third-party client
            return None
        if age_s is None:
            text = f"sent on another clock, and names no recent {server}/health that was received"
            return refusal("late", text)
        if age_s > wait_s:
            text = f"the request is {age_s:.3g} s old, and its client waits for {wait_s:.3g} s"
            return refusal("late", text, value=age_s, limit=wait_s)
        return None
