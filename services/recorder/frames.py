"""What was heard on the bus, to the byte: one frame for each message. Pure.

A recording keeps them beside the JSON that people look at: only they can be replayed as they were,
whoever wrote them in whatever way.
"""

import struct
from collections.abc import Iterable, Iterator
from typing import NamedTuple

HEAD = struct.Struct("<BQI")  # place of the topic in the table, time [ns], bytes that follow


class Frame(NamedTuple):
    """One message as it came."""

    topic: int  # its place in the table of topics
    at_ns: int  # monotonic when it came; in a file the wall clock time when it was written
    data: bytes


def pack_frames(frames: Iterable[Frame]) -> bytes:
    """Return frames as one run of bytes."""
    return b"".join(
        part for topic, at_ns, data in frames for part in (HEAD.pack(topic, at_ns, len(data)), data)
    )


def frames_of(packed: bytes) -> Iterator[Frame]:
    """Yield the frames of a run of bytes. Raise ValueError where it ends within one."""
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
