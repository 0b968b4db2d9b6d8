"""Round-trip times and event rates over sliding windows, with bounded memory.

A time is known once a packet's ID has been echoed, a rate once its window is long enough. Until
then the value is None, never a zero that looks like a measurement.
"""

from collections import deque
from dataclasses import dataclass
from math import ceil

from controller.packet import Packet
from controller.packet_table import Com, FeedbackSwitch

NS_PER_S = 1_000_000_000
# Commands executed by the robot program and echoed by 101; the receiver executes all others.
TAKEN = frozenset({
    Com.MOVE_POSE, Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS, Com.SPEEDS, Com.GAINS, Com.FEEDBACK,
    Com.LIMITS, Com.TCP, Com.SET_POINT,
})  # fmt: skip
MOST_TIMES = 512
MOST_IN_FLIGHT = 512
DROP_AFTER_S = 60.0
RATE_WINDOW_S = 4.0
LEAST_STREAMED = 20  # set points before their median is published
RATE_LEAST_S = 1.0
RATE_MARKS = 32  # per window: its length is exact to 1 / MARKS


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
        self._in_flight: deque[tuple[int, int]] = deque()  # number, sent at
        self._times: deque[tuple[int, int]] = deque(maxlen=MOST_TIMES)  # echoed at, took

    def sent(self, number: int, now_ns: int) -> None:
        """Register a packet sent; numbers increase.

        With too many packets in flight this one is not timed: the older ones are.
        """
        if len(self._in_flight) < MOST_IN_FLIGHT:
            self._in_flight.append((number, now_ns))

    def reached(self, number: int, now_ns: int) -> None:
        """Register an echo: this packet and all before it have arrived."""
        while self._in_flight and self._in_flight[0][0] <= number:
            took_ns = now_ns - self._in_flight.popleft()[1]
            self.last_s = took_ns / NS_PER_S
            self._times.append((now_ns, took_ns))

    @property
    def oldest_ns(self) -> int | None:
        """Time of the oldest packet without an echo, None without such a packet."""
        return self._in_flight[0][1] if self._in_flight else None

    def give_up(self) -> None:
        """Drop the packets in flight: they were voided and will not be echoed."""
        self._in_flight.clear()

    def spread(self, now_ns: int, least: int = 1) -> Spread | None:
        """Return the spread of the last minute, None with fewer than `least` times."""
        oldest_ns = now_ns - DROP_AFTER_S * NS_PER_S
        times = sorted(took for at, took in self._times if at >= oldest_ns)
        if len(times) < least:
            return None
        p50, p99 = (times[ceil(share * len(times)) - 1] for share in (0.50, 0.99))
        return Spread(p50 / NS_PER_S, p99 / NS_PER_S)


def is_taken(packet: Packet) -> bool:
    """Return whether the robot program executes this packet, and 101 echoes it."""
    is_stop = packet.com == Com.FEEDBACK and packet.param == FeedbackSwitch.STOP
    return packet.com in TAKEN and not is_stop


class Echoes:
    """Round trips of all packets to the receiver, and of ring commands to the robot program."""

    def __init__(self) -> None:
        """Start with nothing sent."""
        self.framed, self.taken = RoundTrips(), RoundTrips()
        # Streams only: an idle robot program polls its ring just twice a second.
        self.streamed = RoundTrips()

    def sent(self, packet: Packet, number: int, now_ns: int) -> None:
        """Register a packet sent."""
        self.framed.sent(number, now_ns)
        if is_taken(packet):
            self.taken.sent(number, now_ns)

    def taken_up_to(self, id_: int, now_ns: int) -> None:
        """Register the last packet executed by the robot program."""
        self.taken.reached(id_, now_ns)
        self.streamed.reached(id_, now_ns)

    def give_up_taken(self) -> None:
        """Drop the packets in flight to the robot program: they were voided."""
        self.taken.give_up()
        self.streamed.give_up()


class Rate:
    """Rate of events over a sliding window, with constant memory."""

    def __init__(self, window_s: float = RATE_WINDOW_S, least_s: float = RATE_LEAST_S) -> None:
        """Start a window [s]; the rate is unknown before `least_s` of it have passed."""
        self._window_ns, self._least_ns = round(window_s * NS_PER_S), round(least_s * NS_PER_S)
        self._marks: deque[tuple[int, int]] = deque()  # at, events so far
        self._total = 0

    def count(self, events: int, now_ns: int) -> None:
        """Count events; those of the first call precede the window."""
        self._total += events
        if not self._marks or now_ns - self._marks[-1][0] >= self._window_ns // RATE_MARKS:
            self._marks.append((now_ns, self._total))
        while len(self._marks) > 1 and now_ns - self._marks[1][0] >= self._window_ns:
            self._marks.popleft()

    def hz(self, now_ns: int) -> float | None:
        """Return events per second up to now, None while unknown."""
        earlier = [mark for mark in self._marks if now_ns - mark[0] >= self._window_ns]
        since_ns, before = earlier[-1] if earlier else (self._marks or [(now_ns, 0)])[0]
        if now_ns - since_ns < self._least_ns:
            return None
        return (self._total - before) * NS_PER_S / (now_ns - since_ns)


class WrappingCounterRate:
    """Rate of a counter with wraparound, from its readings."""

    def __init__(self, modulus: int) -> None:
        """Start without readings."""
        self._modulus = modulus
        self._last: int | None = None
        self._rate = Rate()

    def read(self, value: int, now_ns: int) -> None:
        """Evaluate a reading; at most one wraparound may lie between two readings."""
        last = value if self._last is None else self._last
        self._last = value
        self._rate.count((value - last) % self._modulus, now_ns)

    def hz(self, now_ns: int) -> float | None:
        """Return counts per second, None while unknown."""
        return self._rate.hz(now_ns)
