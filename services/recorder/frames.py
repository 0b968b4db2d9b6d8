"""Frames: messages as received on the bus, byte for byte, in a protobuf message. Pure.

A recording keeps them in addition to the readable JSON: only frames can be replayed unchanged,
whatever their publisher and version. They are wrapped as `message Frames { bytes packed = 1; }`:
viewers report an unknown encoding as an error of the file; all of them know this one.
Wire format: protobuf.dev/programming-guides/encoding, schema: its descriptor.proto.
"""

import struct
from collections.abc import Iterable, Iterator
from typing import NamedTuple

HEAD = struct.Struct("<BQI")  # place of the topic in the table, time [ns], bytes that follow
ENCODING = "protobuf"
NAME = "forcemesh.Frames"
LENGTH_DELIMITED = 2
PACKED = bytes([1 << 3 | LENGTH_DELIMITED])  # number and type of the only field
LONGEST_HEAD = 11  # with a length of 64 bits


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
        at += HEAD.size
        if at + size > len(packed):
            raise ValueError("frames end within a message")
        yield Frame(topic, at_ns, packed[at : at + size])
        at += size


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
    length = 0
    for place, byte in enumerate(message[1:LONGEST_HEAD]):
        length |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            packed = message[place + 2 :]
            if message.startswith(PACKED) and len(packed) == length:
                return packed
            break
    raise ValueError("not a message of frames")


def descriptor() -> bytes:
    """Return the schema as a FileDescriptorSet, as MCAP requires."""
    optional_bytes = b"\x18\x01\x20\x01\x28\x0c"  # number 1, label optional, type bytes
    field = _part(2, _part(1, b"packed") + optional_bytes)
    file = _part(1, b"forcemesh/frames.proto") + _part(2, b"forcemesh")
    file += _part(4, _part(1, b"Frames") + field) + _part(12, b"proto3")
    return _part(1, file)


def _part(number: int, data: bytes) -> bytes:
    return varint(number << 3 | LENGTH_DELIMITED) + varint(len(data)) + data
