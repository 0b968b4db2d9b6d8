"""The program that ships, executed: hello, framing, IDs and the ring of packets."""

from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.packet import (
    FRAME_STRIDE,
    PACKET_CHARS,
    ZERO_VEC,
    Packet,
    PacketReader,
    VecInt,
    encode,
)
from controller.packet_table import (
    COMMANDS,
    GAIN_I,
    GAIN_P,
    ID_FIRST,
    ID_LAST,
    TABLE,
    Com,
    SignalParam,
    Status,
    known,
    next_id,
)
from forcemesh.errors import RemoteProtocolError
from tests.fakes.controller_talk import HELLO_PARAM, LIMITS, NO_TCP, SCALES, SET_UP, Talk
from tests.fuzz.framer import names_signals

LEAST: VecInt = (10, 100, 50, 1, 10, 1)
MOST: VecInt = (99, 555, 277, 999, 9999, 1000)
SPEEDS: VecInt = (10_000, 10_000, 10_000, 500, 0, 0)
HELLO = encode(Packet(ID_FIRST, Com.HELLO, HELLO_PARAM, SCALES))
SET_UP_PACKETS = b"".join(
    encode(Packet(ID_FIRST + number, com, param, vec))
    for number, (com, param, vec) in enumerate(
        (
            (Com.LIMITS, 0, LIMITS),
            *((Com.LIMITS, int(bank), vec) for bank, vec in SET_UP),
            (Com.TCP, 0, NO_TCP),
        ),
        start=1,
    )
)
HEAD = 3 * FRAME_STRIDE  # ID, Com, Param
RING = 63  # one slot of 64 stays empty
# A vector that each command accepts, and that moves nothing from where the arm stands.
HARMLESS: dict[int, VecInt] = {
    Com.SPEEDS: SPEEDS,
    Com.LIMITS: LIMITS,
    Com.GAINS: (1, 2, 3, 4, 5, 6),
    Com.TCP: (0, 0, 8000, 0, 0, 0),
    Com.WRENCH: (-1, 2, -3, 4, -5, 6),
    Com.SIGNAL: (-9, 0, 0, 0, 0, 0),
}


@cache
def shared() -> Talk:
    """One controller for many bad packets: it must come back from each of them."""
    return Talk()


def greet_with(talk: Talk, data: bytes) -> None:
    """Connect and send these bytes, then wait until the controller has judged them."""
    if not talk.closed:
        talk.hang_up()
        talk.live(0.01)
    talk.dial()
    talk.write(data)
    talk.wait(lambda: talk.closed or talk.received(Com.HELLO), beat=False)


def busy() -> tuple[Talk, int]:
    """A controller whose robot program waits, for seconds, to hand over the motion of this ID."""
    talk = Talk()
    talk.hello()
    talk.move_up(40.0, speed_mm_s=10.0)
    second = talk.move_up(60.0, speed_mm_s=10.0)
    talk.wait(lambda: talk.taken == second)
    return talk, second


# --- hello ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("id_", [ID_FIRST, ID_FIRST + 5, ID_LAST])
def test_hello_is_answered_with_its_id_version_and_scales_then_reports_follow(id_: int) -> None:
    """Before the hello nothing is sent; after it 101, 102 and 103 carry the hello's ID."""
    talk = Talk()
    talk.dial()
    talk.live(0.3)
    assert talk.inbox == []
    talk.id = id_
    talk.write(encode(Packet(id_, Com.HELLO, HELLO_PARAM, SCALES)))
    talk.wait(lambda: talk.received(Com.HEALTH), 1.0, beat=False)
    assert talk.inbox[0] == Packet(id_, Com.HELLO, HELLO_PARAM, SCALES)
    assert len(talk.received(Com.HELLO)) == 1
    assert (talk.taken, talk.framed, talk.fault) == (id_, id_, 0)
    assert talk.last(Com.HEALTH).vec[4] == id_ - ID_FIRST
    assert talk.send(Com.HEARTBEAT) == next_id(id_)
    talk.wait(lambda: talk.framed == next_id(id_), 1.0)


@pytest.mark.parametrize(
    "data",
    [
        encode(Packet(ID_FIRST, Com.HEARTBEAT)),
        HELLO.replace(b"500000", b"499999"),
        HELLO.replace(b"500000", b"000000"),
        HELLO.replace(b"500000", b"-00005"),
        HELLO.replace(b"001000", b"500000"),
        HELLO.replace(b"003001", b"503001"),
        encode(Packet(ID_FIRST, Com.HELLO, -1, SCALES)),
        encode(Packet(ID_FIRST, Com.HELLO, HELLO_PARAM, (50, 500, 250, 100, 1000, -10))),
        HELLO[:-1] + b"0",
        HELLO.replace(b"000050", b"0005E1"),
        HELLO.replace(b"000050", b" 00050"),
        b"GET / HTTP/1.1\r\nHost: robot\r\nUser-Agent: a browser that got lost\r\n\r\n",
    ],
)
def test_first_packet_that_is_no_hello_closes_the_connection_unanswered(data: bytes) -> None:
    """Fault 4; the next client is served."""
    talk = shared()
    greet_with(talk, data)
    assert talk.closed
    assert talk.inbox == []
    assert talk.value("fm.fault") == 4
    greet_with(talk, HELLO)
    assert talk.inbox[0].com == Com.HELLO


@pytest.mark.parametrize(
    "param", [0, 1, 999, 1001, 2001, HELLO_PARAM - 1, HELLO_PARAM + 1, 499_999]
)
def test_a_client_of_another_version_or_arm_receives_ours_and_is_disconnected(param: int) -> None:
    """The PC can report which end is older, or the other arm; none of it counts as a hello."""
    talk = shared()
    greet_with(talk, HELLO)
    talk.live(0.07)  # what follows the answer to a good hello is done
    latched = talk.value("fm.lack")
    talk.hang_up()
    talk.live(0.07)
    greet_with(talk, encode(Packet(ID_FIRST + 7, Com.HELLO, param, SCALES)))
    talk.wait(lambda: talk.closed, 1.0, beat=False)
    assert talk.inbox == [Packet(ID_FIRST + 7, Com.HELLO, HELLO_PARAM, SCALES)]
    talk.live(0.07)
    assert talk.value("fm.lack") == latched


@pytest.mark.parametrize("index", range(6))
@pytest.mark.parametrize(("edge", "beyond"), [(LEAST, -1), (MOST, 1)], ids=["least", "most"])
def test_scales_are_taken_up_to_their_limits_and_else_stay_as_they_were(
    index: int, edge: VecInt, beyond: int
) -> None:
    """One scale that does not fit leaves all six alone; the answer has those in force."""
    talk = shared()
    greet_with(talk, encode(Packet(ID_FIRST, Com.HELLO, HELLO_PARAM, SCALES)))
    a, b, c, d, e, f = (scale + beyond * (k == index) for k, scale in enumerate(edge))
    greet_with(talk, encode(Packet(ID_FIRST, Com.HELLO, HELLO_PARAM, (a, b, c, d, e, f))))
    assert talk.inbox[0].vec == SCALES
    greet_with(talk, encode(Packet(ID_FIRST, Com.HELLO, HELLO_PARAM, edge)))
    assert talk.inbox[0].vec == edge


def test_a_client_without_a_word_gives_its_place_to_the_next_one() -> None:
    """One connection at a time; a silent one must not keep it for ever."""
    talk = Talk()
    talk.dial()
    assert 5.0 < talk.wait(lambda: talk.closed, 10.0, beat=False) < 8.0
    talk.hello()
    assert talk.status & Status.PROGRAM_RUNNING


# --- packets --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("com", "param"),
    [(com, param) for com in COMMANDS - {Com.HELLO} for param in TABLE[com].params],
)
def test_every_command_of_the_table_is_framed(com: Com, param: int) -> None:
    """Every Param that the table knows, too; a Param more closes the connection."""
    talk = shared()
    greet_with(talk, HELLO)
    talk.live(0.07)  # the watchdog checks twice
    talk.id = ID_FIRST
    vec = HARMLESS.get(com, ZERO_VEC)
    if com in {Com.MOVE_POSE, Com.SET_POINT}:
        vec = talk.shifted_vec()
    if com == Com.MOVE_JOINTS:
        vec = (0, 0, -22_500, 0, -22_500, 0)
    if (com, param) == (Com.SIGNAL, SignalParam.GROUPS):
        vec = (1, 1001, 0, 0, 0, 0)
    talk.send(com, param, vec)
    talk.wait(lambda: talk.framed == ID_FIRST + 1, 1.0, beat=False)
    talk.send(com, TABLE[com].params[-1] + 1, vec)
    talk.wait(lambda: talk.closed, 1.0, beat=False)
    assert talk.value("fm.fault") == 4
    assert talk.framed == ID_FIRST + 1


def test_a_fault_that_comes_while_a_motion_is_taken_is_reported() -> None:
    """Every phase of 40 ms: the motion that ends a hold clears the fault of that hold, no newer."""
    talk = shared()
    for phase in range(400):
        greet_with(talk, HELLO)
        talk.live(0.07 + phase * 1e-4)
        talk.id = ID_FIRST
        talk.write(SET_UP_PACKETS)
        talk.id += 7
        talk.send(Com.MOVE_JOINTS, 0, (0, 0, -22_500, 0, -22_500, 0))
        talk.wait(lambda: talk.framed == ID_FIRST + 8, 1.0, beat=False)
        talk.send(Com.MOVE_JOINTS, 1)
        talk.wait(lambda: talk.closed, 1.0, beat=False)
        assert talk.value("fm.fault") == 4, phase


@settings(max_examples=400)
@given(
    com=st.sampled_from(sorted(COMMANDS - {Com.HELLO})),
    place=st.integers(0, PACKET_CHARS - 1),
    char=st.sampled_from([*"0123456789- .+EeDd^Hh:x\n\0\xff"]),
)
def test_the_receiver_takes_exactly_the_packets_that_the_codec_takes(
    com: Com, place: int, char: str
) -> None:
    """One character changed: the connection stands if and only if it is a packet, and it is due."""
    talk = shared()
    greet_with(talk, HELLO)
    sent = encode(Packet(ID_FIRST + 1, com, 0, HARMLESS.get(com, ZERO_VEC)))
    data = bytearray(sent)
    data[place] = ord(char)
    talk.write(bytes(data))
    talk.live(0.02)
    if (
        is_due(bytes(data), ID_FIRST + 1) and data != sent
    ):  # another number than the harmless one is in force
        shared.cache_clear()
    assert talk.closed != is_due(bytes(data), ID_FIRST + 1), bytes(data)


def is_due(data: bytes, id_: int) -> bool:
    """Return whether the codec and the table take a packet, with this ID and a vector of numbers.

    Where a fixed number is due the receiver accepts one form only: -00000 is no zero there.
    """
    try:
        packet = PacketReader().feed(data)[0]
        row = TABLE[known(packet.com, packet.param)]
    except RemoteProtocolError:
        return False
    fixed = len(data) if not row.numbers(packet.param) else HEAD
    expected = encode(Packet(id_, packet.com, packet.param))
    if row.com == Com.SIGNAL and not names_signals(packet.param, packet.vec):
        return False
    return row.com in COMMANDS - {Com.HELLO} and data[:fixed] == expected[:fixed]


@pytest.mark.parametrize("com", [Com.HELLO, Com.HEARTBEAT])
def test_a_second_hello_and_a_lost_packet_close_the_connection(com: Com) -> None:
    """Hello is the first packet and no other; an ID is the next one, never guessed."""
    talk = shared()
    greet_with(talk, HELLO)
    due = ID_FIRST + 1 + (com == Com.HEARTBEAT)
    talk.write(encode(Packet(due, com, *((HELLO_PARAM, SCALES) if com == Com.HELLO else ()))))
    talk.wait(lambda: talk.closed, 1.0, beat=False)
    assert talk.value("fm.fault") == 4


def test_ids_go_round_at_999999() -> None:
    """500000 follows."""
    talk = Talk()
    talk.hello(id_=ID_LAST - 2, limits=None)
    for expected in (ID_LAST - 1, ID_LAST, ID_FIRST, ID_FIRST + 1):
        talk.do(Com.SPEEDS, 0, SPEEDS)
        assert talk.framed == talk.taken == talk.id == expected
    assert not talk.closed


# --- the ring -------------------------------------------------------------------------------------


def test_packets_in_the_ring_are_framed_at_once_taken_later_and_in_order() -> None:
    """While the robot program hands a motion over, 102 runs ahead of 101, and 103 counts."""
    talk, moving = busy()
    ids = [talk.send(Com.GAINS, 0, (k,) * 6) for k in range(1, RING + 1)]
    talk.wait(lambda: talk.framed == ids[-1], 1.0, beat=False)
    talk.live(0.3, beat=True)
    assert talk.taken == moving
    assert talk.last(Com.HEALTH).vec[2] == RING
    gains: list[int] = []

    def took() -> bool:
        gain = round(talk.value("fm.kp[1]") * GAIN_P)
        gains.extend([gain] if gain not in gains else [])
        return talk.taken == ids[-1]

    talk.wait(took, 10.0)
    assert gains == sorted(gains)
    assert len(gains) > RING // 2  # the ring is emptied faster than a test reads
    assert gains[-1] == RING
    talk.wait(lambda: talk.last(Com.HEALTH).vec[2] == 0, 1.0)


@pytest.mark.parametrize("size", [1, 62, 64, 190])
def test_the_division_of_the_stream_makes_no_difference(size: int) -> None:
    """Bytes come in any pieces, hello too; every packet is framed once, in order."""
    gains = [encode(Packet(ID_FIRST + k, Com.GAINS, 1, (k,) * 6)) for k in range(1, 21)]
    talk, stream = Talk(), HELLO + b"".join(gains)
    talk.dial()
    for place in range(0, len(stream), size):
        talk.write(stream[place : place + size])
        talk.live(0.001)
    talk.wait(lambda: talk.framed == talk.taken == ID_FIRST + 20, 1.0, beat=False)
    assert talk.value("fm.ki[6]") == pytest.approx(20 / GAIN_I)


def test_a_command_from_before_a_hold_is_void() -> None:
    """Gains wait behind a motion when the hold comes: they are not taken after it."""
    talk, _ = busy()
    talk.send(Com.GAINS, 0, (7,) * 6)
    talk.send(Com.HOLD)
    talk.live(1.0, beat=True)
    assert talk.status & Status.HELD
    assert talk.value("fm.kp[1]") == 0
