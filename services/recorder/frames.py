"""File format besides the JSON: names, and frames, the messages byte for byte. Pure.

A recording keeps them in addition to the readable JSON: only frames can be replayed unchanged,
whatever their publisher and version. They are wrapped as `message Frames { bytes packed = 1; }`:
viewers report an unknown encoding as an error of the file; all of them know this one.
Wire format: protobuf.dev/programming-guides/encoding, schema: its descriptor.proto.
"""

import struct
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

METADATA = "forcemesh"
EVENT = "event"
CELL_FILE = "cell.yaml"
FRAMES_TOPIC = "frames"

HEAD = struct.Struct("<BQI")  # place of the topic in the table, time [ns], bytes that follow
PACKED = b"\x0a"  # number and type of the only field: 1, length-delimited
LONGEST_HEAD = 11  # with a length of 64 bits
FRAMES_SCHEMA: dict[str, Any] = {
    "name": "forcemesh.Frames",
    "encoding": "protobuf",
    # Of the message above, as MCAP requires: the FileDescriptorSet that Google's package writes.
    "data": (
        b'\nE\n\x16forcemesh/frames.proto\x12\tforcemesh"\x18\n\x06Frames\x12\x0e'
        b"\n\x06packed\x18\x01 \x01(\x0cb\x06proto3"
    ),
}


class Frame(NamedTuple):
    """One message as received."""

    topic: int  # its place in the table of topics
    at_ns: int  # monotonic time of reception; in a file the wall clock time of publication
    data: bytes


def pack_frames(frames: Iterable[Frame]) -> bytes:
    """Return frames packed into one byte string."""
    return b"".join(
        part for topic, at_ns, data in frames for part in (HEAD.pack(topic, at_ns, len(data)), data)
    )


def frames_of(packed: bytes) -> Iterator[Frame]:
    """Yield the frames of a byte string. Raises ValueError if it ends within one."""
    at = 0
    while at < len(packed):
        if at + HEAD.size > len(packed):
            raise ValueError("frames end within a head")
        topic, at_ns, size = HEAD.unpack_from(packed, at)
        at += HEAD.size + size
        if at > len(packed):
            raise ValueError("frames end within a message")
        yield Frame(topic, at_ns, packed[at - size : at])


# --- the protobuf message -------------------------------------------------------------------------


def varint(number: int) -> bytes:
    """Return the varint of a non-negative number: seven bits a byte, lowest first."""
    head = b""
    while number > 0x7F:
        head += bytes([0x80 | number & 0x7F])
        number >>= 7
    return head + bytes([number])


def wrap(packed: bytes) -> bytes:
    """Return bytes wrapped as a message."""
    return PACKED + varint(len(packed)) + packed


def unwrap(message: bytes) -> bytes:
    """Return the bytes of a message. Raises ValueError if it is another one, or truncated."""
    for at in range(len(PACKED) + 1, min(len(message), LONGEST_HEAD) + 1):
        if message[:at] == PACKED + varint(len(message) - at):
            return message[at:]
    raise ValueError("not a message of frames")
