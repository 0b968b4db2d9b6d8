"""The packet between gateway and controller: nine frames of six characters and a space each.

Sans-IO and the same in both directions: integers to 63 characters and back. What the nine numbers
mean is in `common.packet_table`.
"""

import re
from dataclasses import dataclass

from common.errors import LocalProtocolError, RemoteProtocolError

FRAMES = 9
FRAME_CHARS = 6
FRAME_STRIDE = FRAME_CHARS + 1  # six characters, then one space
PACKET_CHARS = FRAMES * FRAME_STRIDE
VALUE_MIN = -99_999
VALUE_MAX = 999_999

FRAME_NAMES = ("ID", "Com", "Param", "Vec1", "Vec2", "Vec3", "Vec4", "Vec5", "Vec6")

VecInt = tuple[int, int, int, int, int, int]
ZERO_VEC: VecInt = (0, 0, 0, 0, 0, 0)

# ASCII digits only: int() alone would take "1_0000", " 12345", "+12345" and full-width digits.
_FRAME = re.compile(rb"-[0-9]{5}|[0-9]{6}")
_FRAME_AND_SPACE = re.compile(rb"(?:-[0-9]{5}|[0-9]{6}) ")
_PACKET = re.compile(rb"(?:(?:-[0-9]{5}|[0-9]{6}) ){9}")


@dataclass(frozen=True, slots=True)
class Packet:
    """One command or report as the nine integers that travel."""

    id: int
    com: int
    param: int = 0
    vec: VecInt = ZERO_VEC

    @property
    def frames(self) -> tuple[int, ...]:
        """The nine integers in the order in which they travel."""
        return (self.id, self.com, self.param, *self.vec)


def encode(packet: Packet) -> bytes:
    """Return the 63 characters of a packet.

    Raises LocalProtocolError, before a byte exists, when a value is no integer or does not fit
    into six characters. Nothing is ever clipped.
    """
    frames: tuple[object, ...] = packet.frames  # callers without a type checker exist
    if len(frames) != FRAMES:
        raise LocalProtocolError(f"a packet has {FRAMES} frames, this one has {len(frames)}")
    for name, value in zip(FRAME_NAMES, frames, strict=True):
        if not isinstance(value, int) or isinstance(value, bool):
            raise LocalProtocolError(f"{name} is {value!r}, a frame holds an integer")
        if not VALUE_MIN <= value <= VALUE_MAX:
            raise LocalProtocolError(
                f"{name} is {value}, six characters hold {VALUE_MIN} to {VALUE_MAX}"
            )
    return "".join(f"{int(value):06d} " for value in packet.frames).encode("ascii")


class PacketReader:
    """Cuts a stream of bytes into packets; after the first malformed packet it stays dead.

    A new start is never guessed: a peer that is one character off would be read as other numbers.
    """

    def __init__(self) -> None:
        """Start at the first character of a stream."""
        self._rest = b""  # at most one character less than a packet
        self._taken = 0  # packets
        self._death = ""

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that are complete now; how the bytes were cut makes no difference.

        Raises RemoteProtocolError at a malformed packet and at every call after it. Packets of the
        same call that stood before the malformed one are dropped: the link is closed anyway.
        """
        if self._death:
            raise RemoteProtocolError(self._death)
        data = self._rest + data
        whole = len(data) - len(data) % PACKET_CHARS
        self._rest = data[whole:]
        starts = range(0, whole, PACKET_CHARS)
        return [self._take(data[start : start + PACKET_CHARS]) for start in starts]

    def _take(self, chars: bytes) -> Packet:
        if not _PACKET.fullmatch(chars):
            self._death = _describe(chars, self._taken)
            self._rest = b""
            raise RemoteProtocolError(self._death)
        self._taken += 1
        id_, com, param, a, b, c, d, e, f = (int(frame) for frame in chars.split())
        return Packet(id_, com, param, (a, b, c, d, e, f))


def _describe(chars: bytes, packets_before: int) -> str:
    """Say which frame of which packet is wrong, and where in the stream it stands."""
    starts = range(0, PACKET_CHARS, FRAME_STRIDE)
    wrong = [start for start in starts if not _FRAME_AND_SPACE.fullmatch(_cut(chars, start))]
    name, start = FRAME_NAMES[wrong[0] // FRAME_STRIDE], wrong[0]
    frame, space = _cut(chars, start)[:FRAME_CHARS], _cut(chars, start)[FRAME_CHARS:]
    position = packets_before * PACKET_CHARS + start
    where = f"packet {packets_before + 1} of the connection"
    if _FRAME.fullmatch(frame):
        return (
            f"{where}, after {name} at character {position + FRAME_STRIDE}: {_show(space)} "
            f"stands where a space belongs"
        )
    return (
        f"{where}, {name} at character {position + 1}: {_show(frame)} is not an integer "
        f"in six characters, such as 000123 or -00123"
    )


def _cut(chars: bytes, start: int) -> bytes:
    return chars[start : start + FRAME_STRIDE]


def _show(chars: bytes) -> str:
    return "'" + chars.decode("ascii", "backslashreplace").replace("\n", "\\n") + "'"
