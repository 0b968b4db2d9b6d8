"""Frames: messages as received on the bus, byte for byte. Pure.

A recording keeps them in addition to the readable JSON: only frames can be replayed unchanged,
whatever their publisher and version.
"""

import struct
from collections.abc import Iterable, Iterator
from typing import NamedTuple

HEAD = struct.Struct("<BQI")  # place of the topic in the table, time [ns], bytes that follow


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
