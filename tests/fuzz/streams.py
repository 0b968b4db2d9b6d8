"""Packet streams as fuzzer input: segmentation and packet-level mutation.

The first byte selects how the rest is cut into chunks, so a seed is a plain file.
"""

import random
from collections.abc import Callable, Iterator

from controller.packet import PACKET_CHARS
from controller.packet_table import ID_LAST, next_id

LONGEST_CHUNK = 200
VALUES = (
    b"000000",
    b"-00001",
    b"000001",
    b"499999",
    b"500000",
    b"999999",
    b"-99999",
    b"012345",
    b"-00000",
)
ODD = b" -+.eE^HB'_0\x00\xb2\xff\r\n,"
EXAMPLES = tuple(
    b"%06d %06d " % pair + vec
    for pair in [(1, 0), (2, 0), (3, 0), (4, 0), (5, 0), (6, 0), (6, 1), (10, 0), (11, 0)]
    for vec in (b"000100 -00200 000300 000400 000500 000600 ", b"010000 010000 005000 001000 " * 2)
)
EMPTY = tuple(b"%06d %06d " % pair + b"000000 " * 6 for pair in [(7, 0), (7, 1), (7, 2), (8, 0)])
BODIES = tuple(
    body[: PACKET_CHARS - 7] for body in (*EXAMPLES, *EMPTY, b"000012 " + b"000000 " * 7)
)


def chunks(data: bytes) -> Iterator[bytes]:
    """Cut a stream into chunks as selected by its first byte."""
    if not data:
        return
    rng, rest = random.Random(data[0]), data[1:]
    longest = rng.choice((1, 7, 62, 63, 64, LONGEST_CHUNK))
    longest = max(longest, len(rest) // 40)  # limits the duration below the watchdog time
    while rest:
        size = rng.randint(1, longest)
        yield rest[:size]
        rest = rest[size:]


def mutate(data: bytes, max_size: int, seed: int, plain: Callable[[bytes, int], bytes]) -> bytes:
    """Mutate at packet level, occasionally at byte level; IDs are mostly made valid again."""
    rng = random.Random(seed)
    if len(data) < 1 + PACKET_CHARS or rng.random() < 0.2:
        return plain(data, max_size)
    head, rest = data[:1], data[1:]
    packets = [rest[i : i + PACKET_CHARS] for i in range(0, len(rest), PACKET_CHARS)]
    for _ in range(rng.randint(1, 4)):
        rng.choice((_insert, _insert, _drop, _swap, _value, _odd))(packets, rng)
    if rng.random() < 0.8:
        _number(packets)
    if rng.random() < 0.2:
        head = bytes((rng.randrange(256),))
    return (head + b"".join(packets))[:max_size]


def _insert(packets: list[bytes], rng: random.Random) -> None:
    packets.insert(rng.randrange(len(packets) + 1), b"000000 " + rng.choice(BODIES))


def _drop(packets: list[bytes], rng: random.Random) -> None:
    if len(packets) > 1:
        packets.pop(rng.randrange(len(packets)))


def _swap(packets: list[bytes], rng: random.Random) -> None:
    k, m = rng.randrange(len(packets)), rng.randrange(len(packets))
    packets[k], packets[m] = packets[m], packets[k]


def _value(packets: list[bytes], rng: random.Random) -> None:
    k, frame = rng.randrange(len(packets)), rng.randrange(9)
    value = rng.choice((*VALUES, b"%06d" % rng.randrange(1000), b"-%05d" % rng.randrange(99999)))
    packets[k] = packets[k][: 7 * frame] + value + packets[k][7 * frame + 6 :]


def _odd(packets: list[bytes], rng: random.Random) -> None:
    k, at = rng.randrange(len(packets)), rng.randrange(PACKET_CHARS)
    packets[k] = packets[k][:at] + bytes((rng.choice(ODD),)) + packets[k][at + 1 :]


def _number(packets: list[bytes]) -> None:
    """Renumber the IDs consecutively from that of the first packet."""
    first = packets[0][:6]
    id_ = int(first) if first.isdigit() else ID_LAST
    for k in range(1, len(packets)):
        id_ = next_id(id_)
        packets[k] = b"%06d" % id_ + packets[k][6:]
