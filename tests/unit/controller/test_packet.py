"""The packet codec: exact characters, any chunking, and nothing malformed gets through."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.packet import FRAME_NAMES, Packet, PacketReader, encode
from controller.packet_table import (
    COMMANDS,
    MODES,
    NO_ID,
    REPORTS,
    TABLE,
    Com,
    Status,
    greeted,
    greeting,
    known,
    next_id,
    pack_status,
    unpack_status,
)
from forcemesh.errors import LocalProtocolError, RemoteProtocolError

# The base of both ends of the wire; controller/README.md has it for the author of the other end.
FRAMES, FRAME_STRIDE, PACKET_CHARS = 9, 7, 63
ID_FIRST, ID_LAST = 500_000, 999_999
VALUE_MIN, VALUE_MAX = -99_999, 499_999
STATUS_BITS, COUNTER_SPAN = 11, 240

values = st.integers(VALUE_MIN, VALUE_MAX)
ids = st.integers(ID_FIRST, ID_LAST)
packets = st.builds(Packet, ids, values, values, st.tuples(*[values] * 6))
SAMPLE = Packet(500_123, 1, 0, (-123, 499_999, -99_999, 0, 45_000, -1))
LAST_COMMAND = max(com for com in COMMANDS if com < Com.POSE)


def chop(data: bytes, cuts: list[int]) -> list[bytes]:
    """Cut bytes at the given places."""
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


def feed_all(reader: PacketReader, pieces: list[bytes]) -> list[Packet]:
    """Feed piece by piece."""
    return [packet for piece in pieces for packet in reader.feed(piece)]


@given(st.lists(packets, max_size=8), st.lists(st.integers(0, 8 * PACKET_CHARS)))
def test_any_chunking_decodes_alike(sent: list[Packet], cuts: list[int]) -> None:
    """The division of the stream makes no difference to the packets."""
    pieces = chop(b"".join(map(encode, sent)), cuts)
    assert feed_all(PacketReader(), pieces) == sent


def test_the_characters_are_those_of_the_specification() -> None:
    """Six characters with leading zeros, then one space; 123 is 000123."""
    assert encode(SAMPLE) == (
        b"500123 000001 000000 -00123 499999 -99999 000000 045000 -00001 "
    )  # fmt: skip
    assert encode(Packet(ID_FIRST, Com.HEARTBEAT)) == b"500000 000012 " + 7 * b"000000 "


def test_a_packet_is_taken_with_its_last_character() -> None:
    """The last packet of a burst does not wait for the next one, and not one character early."""
    reader, data = PacketReader(), encode(SAMPLE)
    assert reader.feed(data[:-1]) == []
    assert reader.feed(data[-1:]) == [SAMPLE]


@pytest.mark.parametrize("frame", range(FRAMES))
@pytest.mark.parametrize("beyond", [1, 500_001, 10**9])
def test_a_value_that_does_not_fit_is_refused_before_a_byte_exists(frame: int, beyond: int) -> None:
    """Out of range raises with the frame's name and the value; it is never clipped."""
    low, high = (VALUE_MIN, VALUE_MAX) if frame else (ID_FIRST, ID_LAST)
    for value in (low - beyond, high + beyond):
        numbers = [ID_FIRST, *[1] * (FRAMES - 1)]
        numbers[frame] = value
        refusal = f"{FRAME_NAMES[frame]} is {value}, it must be {low} to {high}"
        with pytest.raises(LocalProtocolError, match=refusal):
            encode(Packet(numbers[0], numbers[1], numbers[2], tuple(numbers[3:])))  # type: ignore[arg-type]


@given(
    packets,
    packets,
    st.lists(st.integers(0, FRAMES), min_size=2, max_size=2, unique=True).map(sorted),
    st.lists(values, min_size=1, max_size=8),
)
def test_frames_that_are_lost_or_put_in_are_detected(
    a: Packet, b: Packet, lost: list[int], extra: list[int]
) -> None:
    """A packet that lost some is none; one into which some were put is followed by none."""
    first, second = encode(a), encode(b)
    at, then = (frame * FRAME_STRIDE for frame in lost)
    if lost != [0, FRAMES]:  # a whole packet: consecutive IDs detect that
        with pytest.raises(RemoteProtocolError, match="packet 1 "):
            PacketReader().feed(first[:at] + first[then:] + second)
    more = b"".join(b"%06d " % value for value in extra)
    with pytest.raises(RemoteProtocolError, match="packet 2 " if at else "packet 1 "):
        PacketReader().feed(first[:at] + more + first[at:] + second)


def test_the_error_of_a_shifted_packet_says_what_belongs_there() -> None:
    """An ID stands first and nowhere else."""
    frames = encode(SAMPLE)
    with pytest.raises(RemoteProtocolError, match="an ID, 500000 to 999999, is expected"):
        PacketReader().feed(frames[FRAME_STRIDE:] + frames[:FRAME_STRIDE])
    with pytest.raises(RemoteProtocolError, match="no ID is expected"):
        PacketReader().feed(frames[:FRAME_STRIDE] + frames[:-FRAME_STRIDE])


@pytest.mark.parametrize("value", [1.0, True, None, "1", float("nan")])
def test_a_frame_holds_integers_only(value: object) -> None:
    """Nine of them: a value that is not an int is refused, whatever its text would be."""
    with pytest.raises(LocalProtocolError, match="integer"):
        encode(Packet(ID_FIRST, 1, 0, (value, 0, 0, 0, 0, 0)))  # type: ignore[arg-type]
    with pytest.raises(LocalProtocolError, match="9 frames, this one has 8"):
        encode(Packet(ID_FIRST, 1, 0, (0,) * 5))  # type: ignore[arg-type]


def test_one_wrong_character_is_refused_or_is_another_number() -> None:
    """Every position, every byte: a change gets through only if it makes a valid frame."""
    data = encode(SAMPLE)
    for position in range(PACKET_CHARS):
        in_frame = position % FRAME_STRIDE
        for byte in range(256):
            if byte == data[position]:
                continue
            leading = b"56789" if position == 0 else b"-01234"
            allowed = in_frame < FRAME_STRIDE - 1 and byte in (
                leading if in_frame == 0 else b"0123456789"
            )
            reader = PacketReader()
            mutant = data[:position] + bytes([byte]) + data[position + 1 :]
            if not allowed:
                with pytest.raises(RemoteProtocolError):
                    reader.feed(mutant)
                continue
            (packet,) = reader.feed(mutant)
            differing = [a != b for a, b in zip(packet.frames, SAMPLE.frames, strict=True)]
            assert not any(differing[: position // FRAME_STRIDE])
            assert not any(differing[position // FRAME_STRIDE + 1 :])


@given(packets, packets, st.data())
def test_lost_characters_are_noticed_in_the_packet_they_are_missing_from(
    a: Packet, b: Packet, data: st.DataObject
) -> None:
    """Any number of them, at its start, within it, or at its end: it is never other numbers."""
    at = data.draw(st.integers(0, PACKET_CHARS - 1))
    lost = data.draw(st.integers(1, min(PACKET_CHARS - at, PACKET_CHARS - 1)))
    first = encode(a)
    with pytest.raises(RemoteProtocolError, match="packet 1 "):
        PacketReader().feed(first[:at] + first[at + lost :] + encode(b))


@given(st.lists(packets, max_size=3), st.lists(st.integers(0, 300)), st.integers(0, 62))
def test_the_place_of_a_fault_is_the_same_for_any_chunking(
    sent: list[Packet], cuts: list[int], at: int
) -> None:
    """The error names packet, frame and character of the stream, and none depends on the cuts."""
    bad = bytearray(encode(SAMPLE))
    bad[at] = ord("x")
    data = b"".join(map(encode, sent)) + bytes(bad) + encode(SAMPLE)
    with pytest.raises(RemoteProtocolError) as whole:
        PacketReader().feed(data)
    with pytest.raises(RemoteProtocolError) as chopped:
        feed_all(PacketReader(), chop(data, cuts))
    assert str(chopped.value) == str(whole.value)
    name, is_space = FRAME_NAMES[at // 7], at % 7 == 6
    place = 63 * len(sent) + (at if is_space else at - at % 7) + 1
    shown = "x" if is_space else bytes(bad[at - at % 7 :][:6]).decode()
    where = f"{'after ' if is_space else ''}{name} at character {place}: '{shown}' "
    assert str(whole.value).startswith(f"packet {len(sent) + 1} of the connection, {where}")


def test_a_dead_reader_stays_dead() -> None:
    """After one malformed packet no later packet is accepted."""
    reader = PacketReader()
    with pytest.raises(RemoteProtocolError):
        reader.feed(b"x" * PACKET_CHARS)
    with pytest.raises(RemoteProtocolError):
        reader.feed(encode(SAMPLE))
    with pytest.raises(RemoteProtocolError):
        reader.feed(b"")


@given(st.integers(0, 5000), st.integers(0, 2**STATUS_BITS - 1))
def test_counter_and_status_share_one_frame(counter: int, bits: int) -> None:
    """The counter goes round at 240 and the number always fits a frame."""
    param = pack_status(counter, Status(bits))
    assert 0 <= param <= VALUE_MAX
    assert unpack_status(param) == (counter % COUNTER_SPAN, Status(bits))
    with pytest.raises(LocalProtocolError):  # a twelfth bit would be read as a counter
        pack_status(0, Status(2**STATUS_BITS))


@pytest.mark.parametrize("param", [-1, COUNTER_SPAN * 2048, VALUE_MAX])
def test_a_param_that_is_no_counter_and_status_is_refused(param: int) -> None:
    """Numbers that pack_status cannot make are not unpacked."""
    with pytest.raises(RemoteProtocolError, match=str(param)):
        unpack_status(param)


@given(ids)
def test_ids_are_consecutive_and_go_round(id_: int) -> None:
    """500000 to 999999, then 500000 again."""
    assert next_id(id_) == (ID_FIRST if id_ == ID_LAST else id_ + 1)
    assert ID_FIRST <= next_id(NO_ID) <= ID_LAST
    with pytest.raises(LocalProtocolError, match="ID is"):
        encode(Packet(NO_ID, 12))


RINGS = {
    "MOVE_POSE": 1, "MOVE_JOINTS": 1, "MOVE_BY_JOINTS": 1, "SPEEDS": 1, "SET_POINT": 1,
    "TCP": 2, "GAINS": 2, "FEEDBACK": 2, "LIMITS": 6,
}  # fmt: skip
AT_ONCE = {"WRENCH", "HOLD", "HELLO", "HEARTBEAT", "FORCE_SET_POINT"}


def test_these_commands_wait_in_the_ring_of_the_program() -> None:
    """The program executes them in order, after what waits before them; the others at once."""
    rings = {row.com.name: len(row.ring) for row in TABLE.values()}
    assert {name: rings[name] for name in RINGS} == RINGS
    assert {name for name in AT_ONCE if rings[name]} == set()


def test_each_mode_of_force_feedback_has_its_bits() -> None:
    """Both is both."""
    position, orientation = Status.POSITION_FEEDBACK, Status.ORIENTATION_FEEDBACK
    both = position | orientation
    bits = {"position": position, "orientation": orientation, "both": both}
    assert bits == MODES


def test_every_command_has_its_row() -> None:
    """Numbers without gaps from 1 and from 101, each sent by PC, controller, or both (hello)."""
    assert set(TABLE) == set(Com) == COMMANDS | REPORTS
    assert sorted(Com) == [*range(1, LAST_COMMAND + 1), 101, 102, 103, 104]
    assert {Com.HELLO} == COMMANDS & REPORTS


@pytest.mark.parametrize("com", [-1, 0, LAST_COMMAND + 1, 100, 105, 999_999])
def test_an_unknown_command_is_refused(com: int) -> None:
    """A number that is not in the table is not a command."""
    with pytest.raises(RemoteProtocolError, match=str(com)):
        known(com, 0)


@pytest.mark.parametrize(("param", "version", "arm"), [(999, 999, 0), (1000, 1, 0), (3007, 3, 7)])
def test_a_hello_carries_version_and_arm(param: int, version: int, arm: int) -> None:
    """Version * 1000 + arm, and this is version 3; before it arms had no numbers."""
    assert greeted(param) == (version, arm)
    assert greeted(greeting(arm)) == (3, arm)


@pytest.mark.parametrize(
    ("com", "first", "last"),
    [(103, -99_999, 499_999), (9, 0, 499_999), (1, 0, 0), (6, 0, 1), (7, 0, 2), (8, 0, 0)],
)
def test_a_param_may_be_any_number_that_the_table_names(com: int, first: int, last: int) -> None:
    """An error code may be negative, both ends of a range belong to it; elsewhere 0 means 0."""
    for param in (first, last):
        assert known(com, param) == com
    for param in (first - 1, last + 1):
        with pytest.raises(RemoteProtocolError, match=str(param)):
            known(com, param)
