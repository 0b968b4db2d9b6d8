"""Packet validation of the shipped program, byte by byte, against an independent reading.

The protocol has no checksum: a digit that becomes another digit inside the six numbers is a valid
packet with another number, and only TCP's checksum protects it. The rule here is therefore equality
with a reference, not "every change is detected"; where a change is certainly detected, the test
states it.
"""

import re
from functools import cache

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from controller.packet import FRAME_STRIDE, PACKET_CHARS, Packet, encode
from controller.packet_table import TABLE, Com, next_id
from sim.as_language.parser import load
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork
from sim.robot.arm import SimArm
from sim.robot.settings import SimSettings
from tests.contract.robots import PROGRAM
from tests.fakes.controller import PORT
from tests.fakes.hostile_cell import QUICK, Accepted, watch_program

WELL_FORMED = re.compile(rb"[5-9][0-9]{5} (?:(?:-[0-9]{5}|[0-4][0-9]{5}) ){8}")
NO_VECTOR = {Com.FEEDBACK, Com.HOLD, Com.HEARTBEAT}
OURS = {com for com in TABLE if com < Com.POSE}
HELLO_PARAM = 3001  # version 3, arm 1
HELLO = Packet(700_700, Com.HELLO, HELLO_PARAM, (50, 500, 250, 100, 1000, 10))
DIALOGUE = (
    HELLO,
    Packet(700_701, Com.HOLD),
    Packet(700_702, Com.TCP, 0, (100, -200, 8000, 45000, -500, 1)),
    Packet(700_703, Com.GAINS, 1, (10, 0, 10, 0, 10, 0)),
    Packet(700_704, Com.WRENCH, 0, (-99999, 499999, -1, 0, 1, -12345)),
    Packet(700_705, Com.HEARTBEAT),
    Packet(700_706, Com.FEEDBACK, 2),
)
STREAM = b"".join(encode(packet) for packet in DIALOGUE)
NASTY = b"0123456789-+ .eE^HBxX\x00\n\xff"


def believable(stream: bytes) -> list[str]:
    """Return the packets that a strict reader accepts, up to the first that it rejects."""
    taken: list[str] = []
    id_ = 0
    for at in range(0, len(stream) - PACKET_CHARS + 1, PACKET_CHARS):
        chars = stream[at : at + PACKET_CHARS]
        if not WELL_FORMED.fullmatch(chars):
            break
        frames = [int(frame) for frame in chars.split()]
        if not taken:
            good = frames[1] == Com.HELLO and frames[2] == HELLO_PARAM
            good = good and chars.count(b"-") == 0
        else:
            com, param = frames[1], frames[2]
            good = frames[0] == next_id(id_) and chars[7:8] + chars[14:15] == b"00"
            good = good and com in OURS and com != Com.HELLO and param in _params(com)
            good = good and not (com in NO_VECTOR and any(frames[3:]))
            good = good and not (com in NO_VECTOR and b"-" in chars)
        if not good:
            break
        id_ = frames[0]
        taken.append(chars.decode("latin-1"))
    return taken


def _params(com: int) -> range:
    spans = {Com.GAINS: 2, Com.FEEDBACK: 3, Com.LIMITS: 4, Com.TCP: 2}
    return range(spans.get(Com(com), 1))


class PacketReceiver:
    """An emulated controller that receives packets, one connection after the other."""

    def __init__(self) -> None:
        self.accepted: list[Accepted] = []
        self._network = MemoryNetwork()
        self._machine = Machine(
            SimArm(SimSettings(delay_s=0.0), seed=0), self._network, behaviour=QUICK
        )
        self._machine.load(load(PROGRAM))
        watch_program(self._machine, self.accepted, [])
        self._machine.pendant.execute("fm.main")
        while not self._network.listeners:
            self._pass_ms(1)

    def receive(self, stream: bytes) -> tuple[list[str], bool]:
        """Send a byte stream on a new connection; return accepted packets and whether it ended."""
        self.accepted.clear()
        wire = self._network.dial(PORT)
        wire.send(stream)
        self._pass_ms(60)
        ended = wire.partner is not None and wire.partner.closed
        wire.close()
        while not (wire.partner is not None and wire.partner.closed):
            self._pass_ms(1)
        self._pass_ms(5)
        assert not self._machine.stops
        return [packet.chars for packet in self.accepted], ended

    def _pass_ms(self, count: int) -> None:
        self._machine.advance(self._machine.now_ns + count * 1_000_000)


@cache
def packet_receiver() -> PacketReceiver:
    """Return the receiver that all cases share: earlier connections must make no difference."""
    return PacketReceiver()


def test_the_unchanged_dialogue_is_accepted() -> None:
    """Exactly the packets that were sent are accepted."""
    assert packet_receiver().receive(STREAM) == (believable(STREAM), False)
    assert len(believable(STREAM)) == len(DIALOGUE)


@settings(max_examples=120)
@given(at=st.integers(0, len(STREAM) - 1), byte=st.sampled_from(NASTY))
@example(at=4 * PACKET_CHARS + 21, byte=ord("E"))
def test_a_replaced_byte_is_read_as_a_strict_reader_reads_it(at: int, byte: int) -> None:
    """Any byte of any field is replaced; the connection ends where the strict reader stops."""
    stream = STREAM[:at] + bytes([byte]) + STREAM[at + 1 :]
    accepted_chars, ended = packet_receiver().receive(stream)
    assert accepted_chars == believable(stream)
    assert ended == (len(accepted_chars) < len(DIALOGUE))


@settings(max_examples=60)
@given(
    at=st.integers(0, len(STREAM)),
    drop=st.integers(0, 130),
    insert=st.lists(st.sampled_from(NASTY), max_size=130).map(bytes),
)
def test_bytes_that_are_lost_or_put_in_are_read_as_a_strict_reader_reads_them(
    at: int, drop: int, insert: bytes
) -> None:
    """The program does not find a new start in the middle of the stream."""
    stream = STREAM[:at] + insert + STREAM[at + drop :]
    assert packet_receiver().receive(stream)[0] == believable(stream)


@pytest.mark.parametrize("frame", range(9))
@pytest.mark.parametrize("place", range(FRAME_STRIDE))
def test_a_byte_outside_numbers_is_detected_in_every_position_of_every_field(
    frame: int, place: int
) -> None:
    """The packets before the byte are accepted, those from it on are not, the connection ends."""
    at = 4 * PACKET_CHARS + frame * FRAME_STRIDE + place
    stream = STREAM[:at] + b"x" + STREAM[at + 1 :]
    assert packet_receiver().receive(stream) == (believable(STREAM)[:4], True)


def test_a_digit_of_the_id_is_never_mistaken() -> None:
    """IDs are consecutive: any other number in any of its six digits ends the connection."""
    for place in range(6):
        at = 4 * PACKET_CHARS + place
        digit = (STREAM[at] - 48 + 1) % 10 + 48
        stream = STREAM[:at] + bytes([digit]) + STREAM[at + 1 :]
        assert packet_receiver().receive(stream) == (believable(STREAM)[:4], True)


@pytest.mark.parametrize("frame", range(1, 9))
@pytest.mark.parametrize("digit", b"56789")
def test_a_number_that_begins_like_an_id_is_detected_in_every_field(frame: int, digit: int) -> None:
    """500000 and more is an ID, which is permitted in the first field only."""
    at = 4 * PACKET_CHARS + frame * FRAME_STRIDE
    stream = STREAM[:at] + bytes([digit]) + b"00000" + STREAM[at + 6 :]
    assert packet_receiver().receive(stream) == (believable(STREAM)[:4], True)


@pytest.mark.parametrize(
    ("frame", "lost"), [(k, m) for k in range(9) for m in range(1, min(8, 9 - k) + 1)]
)
def test_lost_whole_frames_are_detected_in_the_packet_that_lost_them(frame: int, lost: int) -> None:
    """At any position: the packet's own ID is missing, or the next packet's comes too early."""
    at = 4 * PACKET_CHARS + frame * FRAME_STRIDE
    stream = STREAM[:at] + STREAM[at + lost * FRAME_STRIDE :]
    assert packet_receiver().receive(stream) == (believable(STREAM)[:4], True)


@pytest.mark.parametrize(
    "packet",
    [
        Packet(700_702, Com.LIMITS, 0, (50, 500, 400_100, 1000, 5000, 250)),  # one digit replaced
        Packet(700_702, Com.SPEEDS, 0, (10_000, 10_000, 10_000, 400_100, 0, 0)),
        Packet(700_702, Com.SPEEDS, 0, (10_000, 10_000, 1, 1, 0, 0)),
    ],
    ids=["limits, 40 m/s", "speeds, 40 m/s", "speeds, 10 nm/s"],
)
def test_a_speed_that_the_language_does_not_take_is_refused(packet: Packet) -> None:
    """It does not cause an error stop, which a person would have to reset."""
    packets = (HELLO, Packet(700_701, Com.HOLD), packet, Packet(700_703, Com.MOVE_BY_JOINTS))
    PacketReceiver().receive(b"".join(encode(each) for each in packets))
