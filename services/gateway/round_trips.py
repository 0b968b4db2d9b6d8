"""How long packets are under way, and how often things happen: sliding windows, bounded memory.

A time is known when the echo of a packet's ID has come, a rate when it was watched long enough.
Before that there is None, never a zero that looks like an answer.
"""

from collections import deque
from dataclasses import dataclass
from math import ceil

from controller.packet import Packet
from controller.packet_table import Com, FeedbackSwitch

NS_PER_S = 1_000_000_000
# What the robot program takes from its ring, and 101 names then; the receiver does the rest alone.
TAKEN = frozenset({
    Com.MOVE_POSE, Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS, Com.SPEEDS, Com.GAINS, Com.FEEDBACK,
    Com.LIMITS, Com.TCP, Com.SET_POINT,
})  # fmt: skip
MOST_TIMES = 512
MOST_UNDER_WAY = 512
FORGET_AFTER_S = 60.0
RATE_WINDOW_S = 4.0
LEAST_STREAMED = 20  # set points before their median is told
RATE_LEAST_S = 1.0
MARKS = 32  # of a window: the error of its length is one part in so many


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and 99th percentile of times [s]: nearest rank, so both are times that occurred."""

    p50_s: float
    p99_s: float


class RoundTrips:
    """From a packet's sending to the report that names it, or a later one."""

    def __init__(self) -> None:
        """Know nothing yet."""
        self.last_s: float | None = None
        self._under_way: deque[tuple[int, int]] = deque()  # number, sent at
        self._times: deque[tuple[int, int]] = deque(maxlen=MOST_TIMES)  # echoed at, took

    def sent(self, number: int, now_ns: int) -> None:
        """Wait for the echo of a packet; numbers come in the order of their sending.

        When too many are under way this one is not timed: the oldest tell how long it takes.
        """
        if len(self._under_way) < MOST_UNDER_WAY:
            self._under_way.append((number, now_ns))

    def reached(self, number: int, now_ns: int) -> None:
        """Take note of an echo: this packet, and all before it, have arrived."""
        while self._under_way and self._under_way[0][0] <= number:
            took_ns = now_ns - self._under_way.popleft()[1]
            self.last_s = took_ns / NS_PER_S
            self._times.append((now_ns, took_ns))

    @property
    def oldest_ns(self) -> int | None:
        """When the oldest packet was sent whose echo has not come; None when none is missing."""
        return self._under_way[0][1] if self._under_way else None

    def give_up(self) -> None:
        """Wait no more for what is under way: it was made void and will not be echoed."""
        self._under_way.clear()

    def spread(self, now_ns: int, least: int = 1) -> Spread | None:
        """Return how long it took lately, or None when fewer came back in the last minute."""
        oldest_ns = now_ns - FORGET_AFTER_S * NS_PER_S
        times = sorted(took for at, took in self._times if at >= oldest_ns)
        if len(times) < least:
            return None
        p50, p99 = (times[ceil(share * len(times)) - 1] for share in (0.50, 0.99))
        return Spread(p50 / NS_PER_S, p99 / NS_PER_S)


def is_taken(packet: Packet) -> bool:
    """Tell whether the robot program takes this packet from its ring, and 101 names it then."""
    is_stop = packet.com == Com.FEEDBACK and packet.param == FeedbackSwitch.STOP
    return packet.com in TAKEN and not is_stop


class Echoes:
    """Round trips of all packets to the receiver, and of some on to the robot program."""

    def __init__(self) -> None:
        """Nothing was sent yet."""
        self.framed, self.taken = RoundTrips(), RoundTrips()
        # Of a stream alone: a program that idles looks into its ring twice a second at first.
        self.streamed = RoundTrips()

    def sent(self, packet: Packet, number: int, now_ns: int) -> None:
        """Wait for what will come back of this packet."""
        self.framed.sent(number, now_ns)
        if is_taken(packet):
            self.taken.sent(number, now_ns)

    def taken_up_to(self, id_: int, now_ns: int) -> None:
        """Take note of what the robot program says that it has taken."""
        self.taken.reached(id_, now_ns)
        self.streamed.reached(id_, now_ns)

    def give_up_taken(self) -> None:
        """Wait no more for what the robot program will not take."""
        self.taken.give_up()
        self.streamed.give_up()


class Rate:
    """How often something happens; the memory it needs does not grow with that."""

    def __init__(self, window_s: float = RATE_WINDOW_S, least_s: float = RATE_LEAST_S) -> None:
        """Watch over a window [s]; say nothing before `least_s` of it has passed."""
        self._window_ns, self._least_ns = round(window_s * NS_PER_S), round(least_s * NS_PER_S)
        self._marks: deque[tuple[int, int]] = deque()  # at, events so far
        self._total = 0

    def count(self, events: int, now_ns: int) -> None:
        """Count events; those of the first call were before the watch began."""
        self._total += events
        if not self._marks or now_ns - self._marks[-1][0] >= self._window_ns // MARKS:
            self._marks.append((now_ns, self._total))
        while len(self._marks) > 1 and now_ns - self._marks[1][0] >= self._window_ns:
            self._marks.popleft()

    def hz(self, now_ns: int) -> float | None:
        """Return events per second up to now, or None while that is not known."""
        past = [mark for mark in self._marks if now_ns - mark[0] >= self._window_ns]
        since_ns, before = past[-1] if past else (self._marks or [(now_ns, 0)])[0]
        if now_ns - since_ns < self._least_ns:
            return None
        return (self._total - before) * NS_PER_S / (now_ns - since_ns)


class Turns:
    """The rate of a counter that goes round: only its readings are known."""

    def __init__(self, modulus: int) -> None:
        """Nothing was read yet."""
        self._modulus = modulus
        self._last: int | None = None
        self._rate = Rate()

    def read(self, value: int, now_ns: int) -> None:
        """Take a reading; between two of them it went round at most once."""
        last = value if self._last is None else self._last
        self._last = value
        self._rate.count((value - last) % self._modulus, now_ns)

    def hz(self, now_ns: int) -> float | None:
        """Return turns per second, or None while that is not known."""
        return self._rate.hz(now_ns)
