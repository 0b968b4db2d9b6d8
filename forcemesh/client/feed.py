"""Feed of one topic for a client: the newest message, or a stream of all messages."""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from forcemesh.bus import Bus, Reader, Reading
from forcemesh.client.ask import remedy_of
from forcemesh.clock import NS_PER_S, wait_until
from forcemesh.codec import Header
from forcemesh.errors import LostError, NotValidError
from forcemesh.messages import Message
from forcemesh.topics import Topic

M = TypeVar("M", bound=Message)

FIRST_WITHIN_S = 2.0  # the slowest topic comes four times a second
SILENCE_S = 3.0
SILENCE_CHECK_S = 0.05  # period of the silence check of a stream
FEED_POLL_S = 0.002
MARK_NS = NS_PER_S // 10
MARKS = 16  # window of the rate estimate: more than a second

Lost = Callable[[str], LostError]  # makes the exception: it knows which other roles are silent


@dataclass(frozen=True, slots=True)
class Received(Generic[M]):
    """One received message, valid or not, with its header."""

    header: Header
    message: M

    @property
    def stamp_s(self) -> float:
        """Time of publication on the publisher's monotonic clock [s]."""
        return self.header.stamp_ns / NS_PER_S


class Feed(Generic[M]):
    """Newest message of a topic; subscribes at the first read. Thread-safe."""

    def __init__(self, bus: Bus, topic: Topic[M], lost: Lost) -> None:
        """Prepare the feed; subscribe later."""
        self.topic = topic
        self._bus = bus
        self._lost = lost
        self._lock = threading.Lock()
        self._reader: Reader[M] | None = None
        self._marks: deque[Header] = deque(maxlen=MARKS)  # some of the headers, for the rate

    def __call__(self, within_s: float = FIRST_WITHIN_S) -> M:
        """Return the newest message; wait for a valid one.

        Raises:
            LostError: No message within `within_s`.
            NotValidError: The publisher sends `valid=False`.
        """
        reading = self.wait(within_s)
        if reading.fresh is not None:
            return reading.fresh
        if reading.silent:
            raise self._lost(reading.fault)
        raise NotValidError(reading.code, reading.fault, remedy_of(reading.code))

    def wait(self, within_s: float) -> Reading[M]:
        """Return the first reading with a valid message, or the last one after `within_s`."""
        reading = self.reading()

        def is_fresh() -> bool:
            nonlocal reading
            reading = self.reading()
            return reading.fresh is not None

        wait_until(self._bus.clock, is_fresh, within_s=within_s, poll_s=FEED_POLL_S)
        return reading

    def reading(self) -> Reading[M]:
        """Return the present reading, valid or not, with its age; never waits, never raises."""
        with self._lock:
            if self._reader is None:
                self._reader = self._bus.reader(self.topic)
            reading, marks = self._reader.read(self._bus.clock.now_ns()), self._marks
            if (header := reading.header) is not None:
                if marks and marks[-1].epoch != header.epoch:
                    marks.clear()
                if not marks or header.stamp_ns - marks[-1].stamp_ns >= MARK_NS:
                    marks.append(header)
            return reading

    @property
    def rate_hz(self) -> float | None:
        """Publishing rate over the last second of readings, None when unknown.

        It follows from the sequence numbers, so that no message is missed.
        """
        reading = self.reading()
        first, last = (self._marks[0] if self._marks else None), reading.header
        if reading.silent or first is None or last is None or last.stamp_ns <= first.stamp_ns:
            return None
        return (last.seq - first.seq) * NS_PER_S / (last.stamp_ns - first.stamp_ns)

    def stream(
        self, *, seconds: float | None = None, silence_s: float = SILENCE_S
    ) -> Iterator[Received[M]]:
        """Yield each received message, valid or not, with its header.

        A slow consumer receives the newest only: gaps show in `header.seq`.

        Args:
            seconds: Duration [s]; None: without end.
            silence_s: Longest wait for a message [s].

        Raises:
            LostError: No message for `silence_s`.
        """
        reader, clock = self._bus.reader(self.topic), self._bus.clock
        began_ns = received_ns = clock.now_ns()
        while seconds is None or clock.now_ns() - began_ns < seconds * NS_PER_S:
            if reader.poll():
                received_ns = clock.now_ns()
                reading = reader.read(received_ns)
                if reading.header is not None and reading.message is not None:
                    yield Received(reading.header, reading.message)
            elif clock.now_ns() - received_ns > silence_s * NS_PER_S:
                why = reader.counters.last_error
                text = f"nothing on {self.topic.key} for {silence_s:g} s"
                raise self._lost(f"{text}: {why}" if why else text)
            else:
                before_ns = clock.now_ns()
                reader.wait(SILENCE_CHECK_S)
                if clock.now_ns() == before_ns:  # a virtual clock: advance it
                    clock.sleep_s(FEED_POLL_S)

    def __iter__(self) -> Iterator[M]:
        """Yield each received message, without end."""
        for reading in self.stream():
            yield reading.message
