"""Packets in flight to the controller: the account of numbers, echoes and times. Pure.

IDs wrap around after 500 000 packets, numbers do not. Serial number arithmetic (RFC 1982) compares
two IDs correctly within half the range only, which is 17 minutes at 250 Hz. The gateway therefore
counts its packets, sends the number modulo 500 000 as the ID, and converts the ID of a report back
to the newest packet number that it can denote.

A time is known once a packet's ID has been echoed, a rate once its window is long enough. Until
then the value is None, never a zero that looks like a measurement.
"""

from collections import deque
from dataclasses import dataclass
from math import ceil

from controller import packet_table
from controller.packet_table import ID_FIRST, TABLE, Com

NS_PER_S = 1_000_000_000
NONE_YET = -1  # less than the number of any packet
MOST_TIMES = 512
MOST_IN_FLIGHT = 512
DROP_AFTER_S = 60.0
RATE_WINDOW_NS = 4 * NS_PER_S
LEAST_STREAMED = 20  # set points before their median is published
RATE_LEAST_NS = NS_PER_S  # of the window, before a rate is known
RATE_MARKS = 32  # per window: its length is exact to 1 / MARKS


def id_of(number: int) -> int:
    """Return the ID of a packet number."""
    return ID_FIRST + number % packet_table.ID_COUNT


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and 99th percentile of times [s]: nearest rank, so both are times that occurred."""

    p50_s: float
    p99_s: float


class RoundTrips:
    """Times from sending a packet to the report that echoes it or a later one."""

    def __init__(self) -> None:
        """Start without measurements."""
        self.last_s: float | None = None
        self.in_flight: deque[tuple[int, int]] = deque()  # without an echo: number, sent at
        self._times: deque[tuple[int, int]] = deque(maxlen=MOST_TIMES)  # echoed at, took

    def sent(self, number: int, now_ns: int) -> None:
        """Register a packet sent; numbers increase.

        With too many packets in flight this one is not timed: the older ones are.
        """
        if len(self.in_flight) < MOST_IN_FLIGHT:
            self.in_flight.append((number, now_ns))

    def reached(self, number: int, now_ns: int) -> None:
        """Register an echo: this packet and all before it have arrived."""
        while self.in_flight and self.in_flight[0][0] <= number:
            took_ns = now_ns - self.in_flight.popleft()[1]
            self.last_s = took_ns / NS_PER_S
            self._times.append((now_ns, took_ns))

    def spread(self, now_ns: int, least: int = 1) -> Spread | None:
        """Return the spread of the last minute, None with fewer than `least` times."""
        oldest_ns = now_ns - DROP_AFTER_S * NS_PER_S
        times = sorted(took for at, took in self._times if at >= oldest_ns)
        if len(times) < least:
            return None
        p50, p99 = (times[ceil(share * len(times)) - 1] for share in (0.50, 0.99))
        return Spread(p50 / NS_PER_S, p99 / NS_PER_S)


class PacketWindow:
    """Packets of a connection: sent, acknowledged by the receiver, executed by the robot program.

    `last`, `framed` and `taken` are packet numbers; they continue across connections.
    """

    def __init__(self, last_id: int) -> None:
        """Continue after an ID; NO_ID is permitted."""
        self.last = (last_id - ID_FIRST) % packet_table.ID_COUNT  # handed out for sending
        self.begin()

    def begin(self) -> None:
        """Begin a connection, whose first packet is hello."""
        self._hello = self._last_for_ring = self.last + 1
        self.framed = self.taken = NONE_YET
        self.receipts, self.executions = RoundTrips(), RoundTrips()
        # Streams only: an idle robot program polls its ring just twice a second.
        self.streamed = RoundTrips()

    @property
    def unexecuted(self) -> int:
        """Number of streamed commands not yet executed by the robot program."""
        return len(self.streamed.in_flight)

    @property
    def unacknowledged(self) -> int:
        """Number of packets not yet acknowledged by the controller's receiver."""
        return self.last - max(self._hello, self.framed)

    def sent(self, com: Com, param: int, now_ns: int, *, streamed: bool) -> None:
        """Register the packet after `last`."""
        self.last += 1
        self.receipts.sent(self.last, now_ns)
        if param in TABLE[com].ring:
            self._last_for_ring = self.last
            self.executions.sent(self.last, now_ns)
        if streamed:
            self.streamed.sent(self.last, now_ns)

    def framed_up_to(self, id_: int, now_ns: int) -> None:
        """Register the ID that 102 echoes: the last packet acknowledged by the receiver."""
        self.framed = self._echoed(id_, self.last, self.framed)
        self.receipts.reached(self.framed, now_ns)

    def number_of(self, framed_id: int) -> int:
        """Return the packet number of an ID that a report echoes as framed, without effect."""
        return self._echoed(framed_id, self.last, NONE_YET)

    def taken_up_to(self, id_: int, now_ns: int) -> None:
        """Register the ID that 101 echoes: the last packet executed by the robot program."""
        self.taken = self._echoed(id_, self._last_for_ring, self.taken)
        self.executions.reached(self.taken, now_ns)
        self.streamed.reached(self.taken, now_ns)

    def void(self) -> None:
        """Drop the packets in flight to the robot program: no echo of them will arrive."""
        self.executions.in_flight.clear()
        self.streamed.in_flight.clear()

    def _echoed(self, id_: int, newest: int, known: int) -> int:
        """Return the number of an echoed ID, which can be that of packets up to `newest`.

        The ID of an earlier connection is ignored. If the last echo is more than one wraparound
        back, the ID may denote a packet in flight, with a probability of one in 500 000; that
        packet then counts as arrived some milliseconds early.
        """
        number = newest - (ID_FIRST + newest - id_) % packet_table.ID_COUNT
        return number if number >= max(self._hello, known) else known


class Rate:
    """Rate of events over a sliding window, with constant memory."""

    def __init__(self) -> None:
        """Start a window."""
        self._marks: deque[tuple[int, int]] = deque()  # at, events so far
        self._total = 0

    def count(self, events: int, now_ns: int) -> None:
        """Count events; those of the first call precede the window."""
        self._total += events
        if not self._marks or now_ns - self._marks[-1][0] >= RATE_WINDOW_NS // RATE_MARKS:
            self._marks.append((now_ns, self._total))
        while len(self._marks) > 1 and now_ns - self._marks[1][0] >= RATE_WINDOW_NS:
            self._marks.popleft()

    def hz(self, now_ns: int) -> float | None:
        """Return events per second up to now, None while unknown."""
        earlier = [mark for mark in self._marks if now_ns - mark[0] >= RATE_WINDOW_NS]
        since_ns, before = earlier[-1] if earlier else (self._marks or [(now_ns, 0)])[0]
        if now_ns - since_ns < RATE_LEAST_NS:
            return None
        return (self._total - before) * NS_PER_S / (now_ns - since_ns)


class WrappingCounterRate(Rate):
    """Rate of a counter with wraparound, from its readings."""

    def __init__(self, modulus: int) -> None:
        """Start without readings."""
        super().__init__()
        self._modulus = modulus
        self._last: int | None = None

    def read(self, value: int, now_ns: int) -> None:
        """Evaluate a reading; at most one wraparound may lie between two readings."""
        last = value if self._last is None else self._last
        self._last = value
        self.count((value - last) % self._modulus, now_ns)
