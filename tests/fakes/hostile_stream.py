"""Faults of the byte stream in one direction between gateway and controller, without sockets.

An abuse takes waiting bytes and returns the pieces that are written now. It counts its bites, so
that a test can prove that the abuse had an effect.

    push(data) ─► waiting ─► abuse.pass_on(waiting, now) ─► pieces, each written on its own
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from controller.packet import PACKET_CHARS

MS = 1_000_000


@dataclass
class Abuse:
    """Base class: passes everything unchanged."""

    bites: int = field(default=0, init=False)
    cuts: bool = field(default=False, init=False)  # the connection is to be reset now
    bitten_ns: int | None = field(default=None, init=False)  # time of the first bite

    def pass_on(self, waiting: bytearray, now_ns: int) -> list[bytes]:
        """Take the bytes that may pass now out of `waiting`; return them in pieces."""
        return list(_pieces(waiting, len(waiting)))


@dataclass
class Chop(Abuse):
    """Cuts into pieces of one size, independent of packets."""

    size: int = 1

    def pass_on(self, waiting: bytearray, now_ns: int) -> list[bytes]:
        """Cut everything; a bite is a cut inside a packet."""
        pieces = list(_pieces(waiting, self.size))
        self.bites += sum(len(piece) % PACKET_CHARS != 0 for piece in pieces)
        return pieces


@dataclass
class Gather(Abuse):
    """Collects bytes until a chunk is full or a time is over, so that the peer gets its reply.

    126 is two packets merged; 255 is four packets and the head of a fifth.
    """

    size: int = 2 * PACKET_CHARS
    wait_ns: int = 40 * MS
    _since_ns: int | None = None

    def pass_on(self, waiting: bytearray, now_ns: int) -> list[bytes]:
        """Write full chunks, and the rest when it has waited; a bite is a full chunk."""
        pieces = []
        while len(waiting) >= self.size:
            pieces.append(_take(waiting, self.size))
            self.bites, self._since_ns = self.bites + 1, None
        if not waiting:
            self._since_ns = None
            return pieces
        self._since_ns = now_ns if self._since_ns is None else self._since_ns
        if now_ns - self._since_ns >= self.wait_ns:
            self._since_ns = None
            pieces.append(_take(waiting, len(waiting)))
        return pieces


@dataclass
class Freeze(Abuse):
    """Delays everything after some bytes for a time; then passes all of it at once."""

    after: int = 0
    for_ns: int = 3000 * MS
    _since_ns: int | None = None

    def pass_on(self, waiting: bytearray, now_ns: int) -> list[bytes]:
        """Hold bytes back; a bite is a byte that is held back."""
        head = _take(waiting, self.after)
        self.after -= len(head)
        if self.after:
            return [head] if head else []
        self._since_ns = now_ns if self._since_ns is None else self._since_ns
        if now_ns - self._since_ns < self.for_ns:
            self.bites = max(self.bites, len(waiting))
            return [head] if head else []
        return [head + _take(waiting, len(waiting))]


@dataclass
class Throttle(Abuse):
    """A line that is slower than its input."""

    bytes_per_s: int = 1000
    _spent_ns: int | None = None

    def pass_on(self, waiting: bytearray, now_ns: int) -> list[bytes]:
        """Pass what the line carries; a bite is a call that leaves bytes waiting."""
        ns_per_byte = 1_000_000_000 // self.bytes_per_s
        if self._spent_ns is None or not waiting:
            self._spent_ns = now_ns
        count = min(len(waiting), (now_ns - self._spent_ns) // ns_per_byte)
        self._spent_ns += count * ns_per_byte
        piece = _take(waiting, count)
        self.bites += bool(waiting)
        return [piece] if piece else []


@dataclass
class Edit(Abuse):
    """Edits once, after some bytes: some are dropped, others put in their place."""

    after: int = 0
    drop: int = 0
    insert: bytes = b""

    def pass_on(self, waiting: bytearray, now_ns: int) -> list[bytes]:
        """Edit when the bytes to drop have arrived; the bite is the edit."""
        if self.bites:
            return list(_pieces(waiting, len(waiting)))
        head = _take(waiting, self.after)
        self.after -= len(head)
        if self.after or len(waiting) < self.drop or not (waiting or self.insert):
            return [head] if head else []
        dropped = _take(waiting, self.drop)
        if dropped != self.insert:
            self.bites = 1
        return [head + self.insert + _take(waiting, len(waiting))]


@dataclass
class Reset(Abuse):
    """Resets the connection after some bytes."""

    after: int = 0

    def pass_on(self, waiting: bytearray, now_ns: int) -> list[bytes]:
        """Pass the last bytes; the bite is the reset."""
        head = _take(waiting, self.after)
        self.after -= len(head)
        if self.after == 0 and not self.cuts:
            self.cuts, self.bites = True, 1
        return [head] if head else []


@dataclass
class Rewrite(Abuse):
    """Passes whole packets, each changed by a function."""

    turn: Callable[[bytes], bytes] = bytes

    def pass_on(self, waiting: bytearray, now_ns: int) -> list[bytes]:
        """Change every whole packet; a bite is one that differs."""
        pieces = []
        while len(waiting) >= PACKET_CHARS:
            packet = _take(waiting, PACKET_CHARS)
            pieces.append(self.turn(packet))
            self.bites += pieces[-1] != packet
        return pieces


@dataclass
class Lane:
    """One direction of one connection."""

    abuse: Abuse = field(default_factory=Abuse)
    sent: bytearray = field(default_factory=bytearray)  # bytes that the sender wrote
    passed: bytearray = field(default_factory=bytearray)  # bytes that the receiver got
    waiting: bytearray = field(default_factory=bytearray)
    stuck: deque[bytes] = field(default_factory=deque)  # pieces that the receiver has no room for

    def push(self, data: bytes) -> None:
        """Accept bytes of the sender."""
        self.sent += data
        self.waiting += data

    def pull(self, now_ns: int) -> list[bytes]:
        """Return the pieces that the receiver gets now."""
        pieces = self.abuse.pass_on(self.waiting, now_ns)
        if self.abuse.bites and self.abuse.bitten_ns is None:
            self.abuse.bitten_ns = now_ns
        for piece in pieces:
            self.passed += piece
        return pieces


@dataclass
class Hop:
    """One connection through the hostile hop: both lanes."""

    to_controller: Lane = field(default_factory=Lane)
    to_gateway: Lane = field(default_factory=Lane)
    vanished: bool = False  # nothing is read, answered or closed any more
    over: bool = False

    def lane(self, direction: str) -> Lane:
        """Return a lane by its name."""
        return self.to_controller if direction == "to_controller" else self.to_gateway

    @property
    def cuts(self) -> bool:
        """Whether an abuse resets the connection."""
        return self.to_controller.abuse.cuts or self.to_gateway.abuse.cuts


def _take(waiting: bytearray, count: int) -> bytes:
    head = bytes(waiting[:count])
    del waiting[:count]
    return head


def _pieces(waiting: bytearray, size: int) -> Iterator[bytes]:
    while waiting:
        yield _take(waiting, size)
