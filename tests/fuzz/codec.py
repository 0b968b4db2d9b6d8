"""Corruption test of the packet readers with ten million streams: `python -m tests.fuzz.codec`.

Streams are split, merged, truncated, shifted by 1 to 62 characters, shifted or cut by whole frames,
or contain an invalid character. Two more kinds show corruption that a protocol without a checksum
detects one packet late. The numbers are chosen to resemble commands, counters and range limits. A
misread is a packet accepted but never sent: by the gateway (a 101 with its 102), or by the
controller (with `tests.fuzz.framer` as the reference implementation).
"""

import argparse
import random
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from controller.packet import PACKET_CHARS, VALUE_MAX, VALUE_MIN, Packet, PacketReader, encode
from controller.packet_table import (
    COUNTER_SPAN,
    ID_FIRST,
    ID_LAST,
    STATUS_SPAN,
    Com,
    Scales,
    greeting,
    next_id,
)
from forcemesh.errors import RemoteProtocolError
from services.gateway.packets import parse_report
from tests.fuzz.framer import frame, numbers

POOL = 3000  # trios of packets to corrupt
# Numbers that resemble other fields when they are read one frame too early or too late.
LOOKALIKES = (0, 1, 2, 3, 7, 8, 9, 12, 101, 102, 103, 5, 6, 4, 10, 11, VALUE_MIN, -1, VALUE_MAX)
DIGITS = frozenset(b"0123456789")
SCALES = Scales()


@dataclass(slots=True)
class Trio:
    """Three consecutive packets as sent, with their prefix."""

    chars: tuple[bytes, bytes, bytes]
    to_gateway: bool
    prefix: bytes = b""  # hello, for the controller


@dataclass(slots=True)
class MisreadCounts:
    """Counters of the test."""

    cases: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    detected_late: int = 0  # accepted, of the kinds that are undetectable at once
    well_formed: Counter[str] = field(default_factory=Counter)  # detectable only by content
    misread: list[str] = field(default_factory=list)


def trios(rng: random.Random) -> list[Trio]:
    """Return valid packet trios: reports, and commands after a hello."""
    found = []
    for number in range(POOL):
        values = [_value(rng) for _ in range(12)]
        if number % 2:
            param = rng.randrange(COUNTER_SPAN) * STATUS_SPAN + rng.randrange(STATUS_SPAN)
            pose = Packet(_id(rng), Com.POSE, param, _six(values))
            joints = Packet(_id(rng), Com.JOINTS, param, _six(values[6:]))
            health = Packet(pose.id, Com.HEALTH, rng.choice((0, -1000, 5)), _six(values[::2]))
            chars = [encode(packet) for packet in (pose, joints, health)]
            if rng.random() < 0.5:
                chars = [chars[2], chars[0], chars[1]]
            found.append(Trio((chars[0], chars[1], chars[2]), to_gateway=True))
            continue
        id_ = _id(rng)
        hello = encode(Packet(id_, Com.HELLO, greeting(1), (50, 500, 250, 100, 1000, 10)))
        commands = []
        for k in range(3):
            id_ = next_id(id_)
            com = Com(rng.choice((1, 2, 3, 4, 5, 6, 8, 10, 11, 12)))
            vec = (0,) * 6 if com in {Com.HOLD, Com.HEARTBEAT} else _six(values[k:])
            commands.append(encode(Packet(id_, com, 0, _six(vec))))
        found.append(Trio((commands[0], commands[1], commands[2]), to_gateway=False, prefix=hello))
    return found


def _id(rng: random.Random) -> int:
    return rng.choice((ID_FIRST, ID_FIRST + 101, ID_LAST - 1, rng.randrange(ID_FIRST, ID_LAST + 1)))


def _value(rng: random.Random) -> int:
    return rng.choice(LOOKALIKES) if rng.random() < 0.5 else rng.randrange(VALUE_MIN, VALUE_MAX + 1)


def _six(values: "list[int] | tuple[int, ...]") -> tuple[int, int, int, int, int, int]:
    a, b, c, d, e, f = values[:6]
    return (a, b, c, d, e, f)


# --- corruptions: each returns the received stream, and its number of valid packets --------------

Spoiled = tuple[bytes, int]


def half(trio: Trio, rng: random.Random) -> Spoiled:
    """Return a stream whose last packet is incomplete."""
    return b"".join(trio.chars)[: rng.randrange(1, 3 * PACKET_CHARS)], 3


def merged(trio: Trio, _rng: random.Random) -> Spoiled:
    """Return all packets in one piece."""
    return b"".join(trio.chars), 3


def truncated(trio: Trio, rng: random.Random) -> Spoiled:
    """Truncate one packet within a frame; the next packet follows."""
    end = rng.choice([k for k in range(PACKET_CHARS) if k % 7])
    return _cut(trio, rng.randrange(2), end)


def frames_lost(trio: Trio, rng: random.Random) -> Spoiled:
    """Remove whole frames at the end of one packet; the next packet follows."""
    return _cut(trio, rng.randrange(2), 7 * rng.randrange(1, 9))


def _cut(trio: Trio, which: int, end: int) -> Spoiled:
    chars = list(trio.chars)
    chars[which] = chars[which][:end]
    return b"".join(chars), which


def shifted(trio: Trio, rng: random.Random) -> Spoiled:
    """Remove 1 to 62 characters at the start."""
    return b"".join(trio.chars)[rng.randrange(1, PACKET_CHARS) :], 0


def shifted_by_frames(trio: Trio, rng: random.Random) -> Spoiled:
    """Remove one to eight whole frames at the start."""
    return b"".join(trio.chars)[7 * rng.randrange(1, 9) :], 0


def odd(trio: Trio, rng: random.Random) -> Spoiled:
    """Replace one character by an invalid one."""
    stream = b"".join(trio.chars)
    at = rng.randrange(len(stream))
    place = at % PACKET_CHARS % 7
    while True:
        byte = rng.randrange(256)
        allowed = byte == 32 if place == 6 else byte in DIGITS or (byte == 45 and place == 0)
        if not allowed:
            return stream[:at] + bytes((byte,)) + stream[at + 1 :], at // PACKET_CHARS


def added(trio: Trio, rng: random.Random) -> Spoiled:
    """Insert characters: digits and a space in the right place form another number.

    One packet may be misread, no more. TCP does not insert; this measures the detection rate.
    """
    stream = b"".join(trio.chars)
    at = rng.randrange(PACKET_CHARS)
    extra = bytes(rng.choice(b"0123456789 -") for _ in range(rng.randrange(1, PACKET_CHARS)))
    return stream[:at] + extra + stream[at:], 0


def frames_added(trio: Trio, rng: random.Random) -> Spoiled:
    """Insert whole valid frames: as above, detected one packet late."""
    stream, at = b"".join(trio.chars), 7 * rng.randrange(1, 9)
    extra = b"".join(b"%06d " % _value(rng) for _ in range(rng.randrange(1, 9)))
    return stream[:at] + extra + stream[at:], 0


SPOILS: dict[str, Callable[[Trio, random.Random], Spoiled]] = {
    spoil.__name__: spoil
    for spoil in (
        half, merged, truncated, frames_lost, shifted, shifted_by_frames, odd, added, frames_added,
    )
}  # fmt: skip
# Undetectable at once: the packet is well formed and has the correct ID.
LATE = {"added", "frames_added"}


# --- acceptance by gateway and controller ---------------------------------------------------------


def run(cases: int, seed: int) -> MisreadCounts:
    """Corrupt this many streams; return the packets accepted but never sent."""
    rng, tally = random.Random(seed), MisreadCounts()
    pool, names = trios(rng), list(SPOILS)
    for _ in range(cases):
        trio, name = pool[rng.randrange(POOL)], names[rng.randrange(len(names))]
        stream, right = SPOILS[name](trio, rng)
        tally.cases += 1
        tally.kinds[name] += 1
        why = judge(trio, (stream, right), tally, name)
        if why and name in LATE:
            tally.detected_late += 1
        elif why:
            tally.misread.append(f"{name}: {why}: {stream!r}")
    return tally


def judge(trio: Trio, spoiled: Spoiled, tally: MisreadCounts, name: str) -> str:
    """Return how a stream was misread, empty if it was not."""
    stream, right = spoiled
    whole = len(stream) // PACKET_CHARS
    reference = [numbers(stream[k * 63 : k * 63 + 63]) for k in range(whole)]
    try:
        read = [packet.frames for packet in PacketReader().feed(stream)]
    except RemoteProtocolError:
        if None not in reference:
            return "the reader rejected a well-formed stream"
        sound = reference.index(None)  # earlier packets may have been read by an earlier call
    else:
        if read != reference:
            return "the reader and the reference disagree"
        sound = whole
    if sound <= right:
        return ""
    tally.well_formed[name] += 1
    packets = [stream[k * 63 : k * 63 + 63] for k in range(sound)]
    return _gateway(trio, packets) if trio.to_gateway else _controller(trio, packets)


def _gateway(trio: Trio, packets: list[bytes]) -> str:
    """Return a misread of the gateway: it accepts a 101 followed by the 102 of the same sample."""
    pose: tuple[bytes, int] | None = None
    for chars in packets:
        packet = PacketReader().feed(chars)[0]
        try:
            parse_report(packet, SCALES)
        except RemoteProtocolError:
            return ""
        if packet.com == Com.JOINTS and pose is not None:
            if pose[1] != packet.param:
                return ""
            if pose[0] + chars not in b"".join(trio.chars):
                return "a sample that was never sent"
        pose = (chars, packet.param) if packet.com == Com.POSE else pose
    return ""


def _controller(trio: Trio, packets: list[bytes]) -> str:
    """Return a misread of the controller: it accepts packets valid by the protocol description."""
    framed = frame(trio.prefix + b"".join(packets))
    taken = [chars for _, _, _, chars in framed.packets]
    return "" if taken == list(trio.chars[: len(taken)]) else "a command that was never sent"


def main() -> int:
    """Corrupt streams and print the number of misreads."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.codec", description=__doc__)
    parser.add_argument("--cases", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    began_s = time.monotonic()
    tally = run(arguments.cases, arguments.seed)
    took_s = time.monotonic() - began_s
    print(f"{tally.cases} streams in {took_s:.0f} s, {tally.cases / took_s:.0f}/s")
    print(f"kinds         {dict(tally.kinds)}")
    print(f"well formed   {dict(tally.well_formed)}")
    print(f"detected late {tally.detected_late}")
    print(f"misread       {len(tally.misread)}")
    for line in tally.misread[:5]:
        print(line)
    return int(bool(tally.misread))


if __name__ == "__main__":
    sys.exit(main())
