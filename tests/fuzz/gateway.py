"""Fuzz target `gateway`: for any bytes the gateway reads the valid prefix, or closes the link.

The result does not depend on the segmentation; only RemoteProtocolError may be raised.
"""

from collections.abc import Iterable
from itertools import takewhile

from controller.packet import PACKET_CHARS, Packet, PacketReader, encode
from controller.packet_table import ID_FIRST, Scales
from forcemesh.errors import RemoteProtocolError
from services.gateway.dialogue import Dialogue
from services.gateway.packets import Event
from tests.fuzz import streams
from tests.fuzz.framer import numbers

MAX_BYTES = 1 + 20 * PACKET_CHARS
mutate = streams.mutate
LATER_NS = 1_000_000


def check(data: bytes) -> None:
    """Read a stream in chunks and as a whole, as packets and as events."""
    cut, whole = list(streams.chunks(data)), [data[1:]]
    aligned = [data[k : k + PACKET_CHARS] for k in range(1, len(data), PACKET_CHARS)]
    valid = list(takewhile(lambda found: found is not None, map(numbers, _whole_ones(aligned))))
    read, death = _packets(aligned)
    assert [packet.frames for packet in read] == valid
    assert bool(death) == (len(valid) < len(_whole_ones(aligned)))
    assert _packets(cut)[1] == _packets(whole)[1] == death
    events, death = _events(cut)
    again, same_death = _events(whole)
    assert bool(death) == bool(same_death)
    assert death or events == again


def _whole_ones(aligned: list[bytes]) -> list[bytes]:
    return [chars for chars in aligned if len(chars) == PACKET_CHARS]


def _packets(pieces: Iterable[bytes]) -> tuple[list[Packet], str]:
    """Return the packets of a reader, and its error; after an error it stays closed."""
    reader, found = PacketReader(), list[Packet]()
    for piece in pieces:
        try:
            found += reader.feed(piece)
        except RemoteProtocolError as error:
            _stays_closed(reader, str(error))
            return found, str(error)
    return found, ""


def _stays_closed(reader: PacketReader, reason: str) -> None:
    try:
        reader.feed(encode(Packet(ID_FIRST, 12)))
    except RemoteProtocolError as error:
        assert str(error) == reason
    else:
        raise AssertionError("a reader accepted data after an error")


def _events(pieces: Iterable[bytes]) -> tuple[list[Event], str]:
    """Return the events of a dialogue, and its error; a hold can always be requested."""
    dialogue, now_ns = Dialogue(Scales()), 0
    PacketReader().feed(dialogue.connected(now_ns))
    found, death = list[Event](), ""
    for piece in pieces:
        now_ns += LATER_NS
        try:
            found += dialogue.feed(piece, now_ns)
        except RemoteProtocolError as error:
            death = str(error)
            break
        sent = dialogue.tick(now_ns, permitted=True)
        assert dialogue.ready or not sent
        PacketReader().feed(sent)
    assert len(PacketReader().feed(dialogue.hold(now_ns))) == 1
    return found, death
