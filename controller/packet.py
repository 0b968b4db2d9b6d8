"""Packet codec between gateway and controller: nine frames of six characters and a space each.

Sans-IO and the same in both directions: integers to 63 characters and back.
`controller.packet_table` defines the meaning of the nine numbers.

There is no checksum, but the first frame marks the packet: an ID is 500000 or more and begins with
5 to 9; each of the other eight is less and begins with 0 to 4 or a minus. Nine consecutive frames
that start 1 to 8 frames late hold the ID of the next packet in one of the places 2 to 9, and
another number in the first place. Both errors are detected, for all numbers and in both directions.
The same applies to a packet that has lost frames. Inserted frames, or frames lost across the end of
a packet, can produce one misread packet; the next ID is then in a wrong place. A shift that is not
by whole frames puts a space into a number.
"""

import re
from dataclasses import dataclass

from controller.packet_table import ID_FIRST, ID_LAST, Six
from forcemesh.errors import LocalProtocolError, RemoteProtocolError

FRAMES = 9
FRAME_CHARS = 6
FRAME_STRIDE = FRAME_CHARS + 1  # six characters, then one space
PACKET_CHARS = FRAMES * FRAME_STRIDE
VALUE_MIN = -99_999  # of every frame but the ID
VALUE_MAX = ID_FIRST - 1

FRAME_NAMES = ("ID", "Com", "Param", "Vec1", "Vec2", "Vec3", "Vec4", "Vec5", "Vec6")

VecInt = Six
ZERO_VEC: VecInt = (0, 0, 0, 0, 0, 0)

# ASCII digits only: int() alone would take "1_0000", " 12345", "+12345" and full-width digits.
_INTEGER = re.compile(rb"-[0-9]{5}|[0-9]{6}")
_ID = rb"[5-9][0-9]{5}"
_VALUE = rb"(?:-[0-9]{5}|[0-4][0-9]{5})"
_PACKET = re.compile(rb"%b (?:%b ){8}" % (_ID, _VALUE))
_FRAMES_AND_SPACES = [re.compile(frame + rb" ") for frame in (_ID, *[_VALUE] * (FRAMES - 1))]


@dataclass(frozen=True, slots=True)
class Packet:
    """One command or report as nine integers."""

    id: int
    com: int
    param: int = 0
    vec: VecInt = ZERO_VEC

    @property
    def frames(self) -> tuple[int, ...]:
        """The nine integers in the order of transmission."""
        return (self.id, self.com, self.param, *self.vec)


def encode(packet: Packet) -> bytes:
    """Return the 63 characters of a packet.

    Raises LocalProtocolError when a value is not an integer or does not fit into six characters.
    Values are never clipped.
    """
    frames: tuple[object, ...] = packet.frames  # for callers without a type checker
    if len(frames) != FRAMES:
        raise LocalProtocolError(f"a packet has {FRAMES} frames, this one has {len(frames)}")
    for name, value in zip(FRAME_NAMES, frames, strict=True):
        if not isinstance(value, int) or isinstance(value, bool):
            raise LocalProtocolError(f"{name} is {value!r}, a frame holds an integer")
        low, high = (ID_FIRST, ID_LAST) if name == "ID" else (VALUE_MIN, VALUE_MAX)
        if not low <= value <= high:
            raise LocalProtocolError(f"{name} is {value}, it must be {low} to {high}")
    return "".join(f"{int(value):06d} " for value in packet.frames).encode("ascii")


class PacketReader:
    """Parser of a byte stream into packets; after the first malformed packet every call fails.

    It does not resynchronise: a stream that is one character off would be read as other numbers.
    """

    def __init__(self) -> None:
        """Begin at the first character of a stream."""
        self._rest = b""  # at most one character less than a packet
        self._taken = 0  # packets
        self._death = ""

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that are now complete, however the bytes are chunked.

        Raises RemoteProtocolError at a malformed packet and at every later call. Valid packets
        before it in the same call are dropped, because the link is closed.
        """
        if self._death:
            raise RemoteProtocolError(self._death)
        data = self._rest + data
        whole = len(data) - len(data) % PACKET_CHARS
        self._rest = data[whole:]
        packets = []
        for start in range(0, whole, PACKET_CHARS):
            chars = data[start : start + PACKET_CHARS]
            if not _PACKET.fullmatch(chars):
                self._death = _describe(chars, self._taken)
                self._rest = b""
                raise RemoteProtocolError(self._death)
            self._taken += 1
            id_, com, param, a, b, c, d, e, f = map(int, chars.split())
            packets.append(Packet(id_, com, param, (a, b, c, d, e, f)))
        return packets


def _describe(chars: bytes, packets_before: int) -> str:
    """Describe which frame of which packet is wrong, and its position in the stream."""
    starts = range(0, PACKET_CHARS, FRAME_STRIDE)
    cuts = [chars[start : start + FRAME_STRIDE] for start in starts]
    rules = zip(_FRAMES_AND_SPACES, cuts, strict=True)
    wrong = next(k for k, (rule, cut) in enumerate(rules) if not rule.fullmatch(cut))
    name, frame, space = FRAME_NAMES[wrong], cuts[wrong][:FRAME_CHARS], cuts[wrong][FRAME_CHARS:]
    position = packets_before * PACKET_CHARS + wrong * FRAME_STRIDE
    where = f"packet {packets_before + 1} of the connection"
    if not _INTEGER.fullmatch(frame):
        return (
            f"{where}, {name} at character {position + 1}: {_show(frame)} is not an integer "
            f"in six characters, such as 000123 or -00123"
        )
    if space != b" ":
        return (
            f"{where}, after {name} at character {position + FRAME_STRIDE}: {_show(space)} "
            f"is in place of a space"
        )
    belongs = f"an ID, {ID_FIRST} to {ID_LAST}, is expected" if wrong == 0 else "no ID is expected"
    return (
        f"{where}, {name} at character {position + 1}: {_show(frame)} is where {belongs}: "
        f"missing or extra frames"
    )


def _show(chars: bytes) -> str:
    return "'" + chars.decode("ascii", "backslashreplace").replace("\n", "\\n") + "'"
