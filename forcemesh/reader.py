"""Reader of one topic: checks and counts messages, and classifies the newest at every read."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

from forcemesh.clock import NS_PER_S, Clock
from forcemesh.codec import Header, decode
from forcemesh.errors import MessageError, MisroutedError
from forcemesh.messages import Message
from forcemesh.topics import Topic

M = TypeVar("M", bound=Message)

LONGEST_FAULT = 400  # leaves room for a prefix of the next service
CONFLICT_NS = NS_PER_S  # hold time of the flag that a topic has two publishers
RESTART_S = 0.1  # shorter than any restart of a process
MOST_RETIRED = 64  # stored former publishers; the oldest is dropped
BAD_MESSAGES = 5  # excess of bad over good messages that is a fault


class Source(Protocol):
    """Source of the newest bytes of one key; older ones not taken are dropped."""

    def take(self) -> bytes | None:
        """Return the newest bytes not yet taken, or None."""

    def wait(self, timeout_s: float) -> None:
        """Sleep until a message arrives, at most for a time [s]."""


class Origin(NamedTuple):
    """Sensor sample on which a message is based."""

    stamp_ns: int
    seq: int


class Reading(NamedTuple, Generic[M]):
    """Result of a read: the last message, its age, and its fault, if any."""

    message: M | None
    header: Header | None
    age_s: float
    fault: str  # empty when the message is present, valid and fresh
    silent: bool = False  # missing or stale: no messages from its publisher
    code: str = ""  # of forcemesh/faults.py, for the fault
    conflict: bool = False  # two processes have published it within the last second

    @property
    def fresh(self) -> M | None:
        """The message if it has no fault, else None."""
        return None if self.fault else self.message

    @property
    def origin(self) -> Origin | None:
        """The sensor sample on which the message is based."""
        if self.header is None or self.header.sensor_stamp_ns is None:
            return None
        return Origin(self.header.sensor_stamp_ns, self.header.sensor_seq or 0)


@dataclass(slots=True)
class ReadCounters:
    """Counters of received and dropped messages."""

    received: int = 0
    superseded: int = 0
    undecodable: int = 0
    misrouted: int = 0  # addressed to another topic or cell
    repeated: int = 0  # duplicate or reordered within one epoch
    retired: int = 0  # from a replaced publisher: two publishers
    overlaps: int = 0  # changes of publisher too fast for a restart: two publishers
    last_error: str = ""


class Reader(Generic[M]):
    """Newest message of one topic, classified at every read: missing, invalid, stale or good."""

    def __init__(
        self, topic: Topic[M], source: Source, clock: Clock, stale_after_s: float, *, cell: str
    ) -> None:
        """Wrap the source of a topic of a cell."""
        self.topic = topic
        self._address = f"{cell}/{topic.key}"
        self.stale_after_s = stale_after_s
        self.counters = ReadCounters()
        self._source = source
        self._clock = clock
        fault = f"{topic.key} missing"
        self._missing: Reading[M] = Reading(
            None, None, float("inf"), fault, silent=True, code="missing"
        )
        self._last: tuple[M, Header] | None = None
        self._broken: MessageError | None = None  # error of the last message, if undecodable
        self._received_ns = 0
        self._since_ns = 0  # its age counts from here
        self._retired_epochs: deque[int] = deque(maxlen=MOST_RETIRED)
        self._conflict_until_ns = 0
        self._suspicion = 0  # leaky counter: +1 per bad, -1 per good message
        self._is_new = False  # the last message was not read yet

    def poll(self) -> bool:
        """Process the received payload; return whether a newer message was accepted.

        Repeated messages are dropped, and those of a publisher that was replaced.
        """
        data = self._source.take()
        if data is None:
            return False
        try:
            header, message = decode(data, self.topic.message, self._address)
        except MessageError as error:
            self.counters.last_error = str(error)
            if isinstance(error, MisroutedError):  # not about this topic
                self.counters.misrouted += 1
            else:
                self.counters.undecodable += 1
                self._broken = error
            self._suspect()
            return False
        now_ns = self._clock.now_ns()
        if header.epoch in self._retired_epochs:  # the replaced publisher is still alive
            self.counters.retired += 1
            self._conflict_until_ns = now_ns + CONFLICT_NS
            return False
        if self._last is not None:
            last = self._last[1]
            if header.epoch != last.epoch:
                self._retired_epochs.append(last.epoch)
                if now_ns - self._received_ns < RESTART_S * NS_PER_S:
                    self.counters.overlaps += 1
                    self._conflict_until_ns = now_ns + CONFLICT_NS
            elif header.seq <= last.seq:
                self.counters.repeated += 1
                self._suspect()
                return False
            else:
                self.counters.superseded += header.seq - last.seq - 1
        self.counters.received += 1
        self._suspicion = max(self._suspicion - 1, 0)
        self._broken = None
        self._last, self._is_new = (message, header), True
        self._received_ns = self._since_ns = now_ns
        if header.boot == self._clock.boot:
            # After a freeze the newest message waiting in the channel has just arrived and is old.
            self._since_ns = min(now_ns, header.stamp_ns)
        return True

    def wait(self, timeout_s: float) -> None:
        """Sleep until a message arrives, at most for `timeout_s` [s]."""
        self._source.wait(timeout_s)

    def read(self, now_ns: int) -> Reading[M]:
        """Process the received payload and classify the newest message at this time."""
        self.poll()
        return self._classified(now_ns)

    def readings(self, now_ns: int) -> Iterator[Reading[M]]:
        """Yield a reading of each message of a queue since the last one; one of the last if none.

        Also of the message that a poll has accepted.
        """
        if not self._is_new:
            self.poll()
        yield self._classified(now_ns)
        while self.poll():
            yield self._classified(now_ns)

    def _classified(self, now_ns: int) -> Reading[M]:
        """Return the newest message with its age and fault at this time."""
        self._is_new = False
        if self._last is None:
            return self._missing
        message, header = self._last
        age_s = (now_ns - self._since_ns) / NS_PER_S
        conflict = now_ns < self._conflict_until_ns
        if age_s > self.stale_after_s:
            age_ms, limit_ms = age_s * 1e3, self.stale_after_s * 1e3
            code, fault = "stale", f"stale: {age_ms:.0f} ms old, limit {limit_ms:.0f} ms"
        elif self._broken is not None:  # the present value is unknown
            code, fault = self._broken.code, f"unreadable: {self._broken}"
        elif self._suspicion > BAD_MESSAGES:
            count = self.counters
            dropped = f"{count.repeated} repeated, {count.undecodable} unreadable"
            text = f"{dropped}, {count.misrouted} addressed to another topic or cell"
            code, fault = "bad_messages", f"has too many bad messages: {text}"
        elif not message.valid:
            reason = message.reason or "no reason given"
            code, fault = message.code or "invalid", f"invalid: {reason}"
        else:
            return Reading(message, header, age_s, "", conflict=conflict)
        fault = f"{self.topic.key} {fault}"[:LONGEST_FAULT]
        return Reading(
            message, header, age_s, fault, silent=code == "stale", code=code, conflict=conflict
        )

    def _suspect(self) -> None:
        self._suspicion = min(self._suspicion + 1, 2 * BAD_MESSAGES)
