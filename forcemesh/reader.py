"""Reads one topic: what comes in is checked, counted, and judged at every look."""

from collections import deque
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

from forcemesh.clock import NS_PER_S, Clock
from forcemesh.codec import Header, decode
from forcemesh.errors import MessageError, MisroutedError
from forcemesh.messages import Message
from forcemesh.topics import Topic

M = TypeVar("M", bound=Message)

LONGEST_FAULT = 400  # leaves room for what the next service says before it
CONFLICT_S = 1.0  # so long it is remembered that a topic had two writers at once
RESTART_S = 0.1  # no process dies and speaks again within this
MOST_RETIRED = 64  # former writers that are remembered; the oldest one is forgotten
BAD_MESSAGES = 5  # more of them than good ones: something repeats, shuffles or spoils a topic


class Source(Protocol):
    """Newest bytes of one key; older ones that nobody took are gone."""

    def take(self) -> bytes | None:
        """Return the newest bytes that were not taken yet, or None."""

    def wait(self, timeout_s: float) -> None:
        """Sleep until there are such bytes, or the time [s] is over."""


class Origin(NamedTuple):
    """The sensor sample behind a message."""

    stamp_ns: int
    seq: int


class Reading(NamedTuple, Generic[M]):
    """What a reader knows: the last message, and what is wrong with it, if anything."""

    message: M | None
    header: Header | None
    age_s: float
    fault: str  # empty when the message is present, valid and fresh
    silent: bool = False  # missing or stale: its writer is not heard
    code: str = ""  # of forcemesh/faults.py, for the fault
    conflict: bool = False  # two processes have written it within the last second

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
    misrouted: int = 0  # written for another topic, or for another cell
    repeated: int = 0  # duplicate or reordered within one epoch
    retired: int = 0  # from a writer that another one has followed: two writers
    overlaps: int = 0  # changes of writer too quick for a restart: two writers
    last_error: str = ""


class Reader(Generic[M]):
    """Newest message of one topic, judged on every read: missing, invalid, stale or good."""

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
        self._last: tuple[Header, M] | None = None
        self._broken: MessageError | None = None  # what came last could not be read
        self._received_ns = 0
        self._retired_epochs: deque[int] = deque(maxlen=MOST_RETIRED)
        self._conflict_ns: int | None = None
        self._suspicion = 0  # one up with each bad message, one down with each good one

    def poll(self) -> bool:
        """Take what has come in; tell whether a newer message was accepted."""
        data = self._source.take()
        if data is None:
            return False
        try:
            header, message = decode(data, self.topic.message, self._address)
        except MisroutedError as error:  # says nothing of this topic of this cell
            self.counters.misrouted += 1
            self.counters.last_error = str(error)
            self._suspect()
            return False
        except MessageError as error:
            self.counters.undecodable += 1
            self.counters.last_error = str(error)
            self._broken = error
            self._suspect()
            return False
        return self._accept(header, message)

    def wait(self, timeout_s: float) -> None:
        """Sleep until something has come in, or the time [s] is over."""
        self._source.wait(timeout_s)

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
            message,
            header,
            age_s,
            fault[:LONGEST_FAULT],
            silent=code == "stale",
            code=code,
            conflict=self._in_conflict(now_ns),
        )

    def _judge(self, message: M, age_s: float) -> tuple[str, str]:
        """Return code and text of what is wrong, both empty when nothing is."""
        if age_s > self.stale_after_s:
            age_ms, limit_ms = age_s * 1e3, self.stale_after_s * 1e3
            return "stale", f"{self.topic.key} stale: {age_ms:.0f} ms old, limit {limit_ms:.0f} ms"
        if self._broken is not None:  # not what it said before, nor zero: unknown
            return self._broken.code, f"{self.topic.key} unreadable: {self._broken}"
        if self._suspicion > BAD_MESSAGES:
            count = self.counters
            dropped = f"{count.repeated} repeated, {count.undecodable} unreadable"
            text = f"{dropped}, {count.misrouted} written for another topic or cell"
            return "bad_messages", f"{self.topic.key} is not orderly: {text}"
        if not message.valid:
            reason = message.reason or "no reason given"
            return message.code or "invalid", f"{self.topic.key} invalid: {reason}"
        return "", ""

    def _accept(self, header: Header, message: M) -> bool:
        now_ns = self._clock.now_ns()
        if header.epoch in self._retired_epochs:
            self.counters.retired += 1
            self._conflict_ns = now_ns
            return False
        if self._last is not None:
            last = self._last[0]
            if header.epoch != last.epoch:
                self._retire(last.epoch, now_ns)
            elif header.seq <= last.seq:
                self.counters.repeated += 1
                self._suspect()
                return False
            else:
                self.counters.superseded += header.seq - last.seq - 1
        self.counters.received += 1
        self._suspicion = max(self._suspicion - 1, 0)
        self._broken = None
        self._last = (header, message)
        self._received_ns = now_ns
        return True

    def _retire(self, epoch: int, now_ns: int) -> None:
        """Never hear a writer again that another one follows; it may still be alive."""
        self._retired_epochs.append(epoch)
        if now_ns - self._received_ns < RESTART_S * NS_PER_S:
            self.counters.overlaps += 1
            self._conflict_ns = now_ns

    def _in_conflict(self, now_ns: int) -> bool:
        return self._conflict_ns is not None and now_ns - self._conflict_ns < CONFLICT_S * NS_PER_S

    def _suspect(self) -> None:
        self._suspicion = min(self._suspicion + 1, 2 * BAD_MESSAGES)

    def _age_s(self, header: Header, now_ns: int) -> float:
        """Age since arrival, and on one and the same clock also since it was written.

        The second one matters after a freeze: the newest message waiting in the channel is old.
        """
        since_ns = self._received_ns
        if header.boot == self._clock.boot:
            since_ns = min(since_ns, header.stamp_ns)
        return (now_ns - since_ns) / NS_PER_S
