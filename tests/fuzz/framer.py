"""Reference implementation of the controller's receiver.

Written from controller/README.md, independently of the AS program and of the gateway's reader: the
fuzzer compares all three.
"""

from dataclasses import dataclass, field

from controller.packet_table import NO_ID, TABLE, Com, SignalParam, greeting, next_id

FRAMES, CHARS = 9, 63
ARM = 1  # fm.num as it ships
DIGITS = frozenset(b"0123456789")
ZERO_VEC = b"000000 " * 6
AT_ONCE = {
    Com.WRENCH,
    Com.FORCE_SET_POINT,
    Com.HOLD,
    Com.HEARTBEAT,
    Com.SIGNAL,
}  # also 7 with Param 2; all other commands are queued
MOTIONS = {Com.MOVE_POSE, Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS, Com.SET_POINT, Com.FEEDBACK}


@dataclass(slots=True)
class Framed:
    """Valid prefix of a stream, and the expected state after it."""

    last_id: int = NO_ID  # of the last valid packet; NO_ID: the hello was invalid
    greeted_id: int = NO_ID  # of the hello
    answered: bool = False  # the hello was answered
    closed: bool = False  # protocol error: hold, and close
    packets: list[tuple[int, int, tuple[int, ...], bytes]] = field(default_factory=list)

    def count(self, com: Com, param: int | None = None) -> int:
        """Return the number of packets of this command after the hello."""
        return sum(c == com and param in (None, p) for c, p, _, _ in self.packets)

    @property
    def queued(self) -> list[bytes]:
        """Return the packets for the robot program."""
        return [q for c, p, _, q in self.packets if c not in AT_ONCE and (c, p) != (7, 2)]

    @property
    def hold_id(self) -> int:
        """ID of the last command 8, or of the hello, which also holds."""
        ids = [int(q[:6]) for c, _, _, q in self.packets if c == Com.HOLD]
        return (ids or [self.greeted_id])[-1]

    @property
    def wrench(self) -> tuple[int, ...] | None:
        """Vector of the last command 4."""
        vectors = [v for c, _, v, _ in self.packets if c == Com.WRENCH]
        return vectors[-1] if vectors else None

    @property
    def may_move(self) -> bool:
        """Whether any packet commands a motion, or starts force feedback."""
        return any(c in MOTIONS and (c, p) != (7, 2) for c, p, _, _ in self.packets)


def frame(stream: bytes) -> Framed:
    """Return the packets that a receiver accepts from a stream, up to the first error."""
    framed = Framed()
    for start in range(0, len(stream) - CHARS + 1, CHARS):
        chars = stream[start : start + CHARS]
        if start == 0:
            _greet(chars, framed)
        else:
            _take(chars, framed)
        if framed.closed:
            break
    return framed


def _greet(chars: bytes, framed: Framed) -> None:
    """Accept the first packet: hello with any ID; a wrong version gets a reply and a close."""
    found = numbers(chars)
    framed.closed = True
    if found is None or b"-" in chars or found[1] != Com.HELLO:
        return
    framed.last_id, framed.answered = found[0], True
    framed.greeted_id = found[0]
    framed.closed = found[2] != greeting(ARM)


def _take(chars: bytes, framed: Framed) -> None:
    """Accept a later packet: the next ID, a known command and Param, no second hello."""
    found = numbers(chars)
    framed.closed = True
    if found is None or not chars.startswith(b"%06d " % next_id(framed.last_id)):
        return
    com, param = found[1], found[2]
    if com not in set(Com) or com >= Com.POSE or com == Com.HELLO:
        return
    row = TABLE[Com(com)]
    if param not in row.params or b"-" in chars[7:21]:
        return
    if not row.numbers(param) and chars[21:] != ZERO_VEC:
        return
    if com == Com.SIGNAL and not names_signals(param, found[3:]):
        return
    framed.last_id, framed.closed = found[0], False
    framed.packets.append((com, param, found[3:], chars))


def names_signals(param: int, vec: tuple[int, ...]) -> bool:
    """Whether command 15 has an output, or places where a group of 16 signals can begin."""
    if param == SignalParam.SWITCH:
        return 1 <= abs(vec[0]) <= 960
    return all(first == 0 or 1 <= first <= 945 or 1001 <= first <= 1945 for first in vec)


def numbers(chars: bytes) -> tuple[int, ...] | None:
    """Return the nine numbers; None for an invalid character or a misplaced ID."""
    found = []
    for k in range(FRAMES):
        six, space = chars[7 * k : 7 * k + 6], chars[7 * k + 6 : 7 * k + 7]
        digits = six[1:] if six[:1] == b"-" else six
        if space != b" " or not set(digits) <= DIGITS:
            return None
        if (int(six) >= 500_000) != (k == 0):
            return None
        found.append(int(six))
    return tuple(found)
