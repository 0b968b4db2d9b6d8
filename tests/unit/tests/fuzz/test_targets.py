"""Every seed of the fuzz targets, and whatever once broke one, is replayed without the fuzzer."""

import importlib
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.packet import FRAME_STRIDE, PACKET_CHARS
from tests.fuzz import receiver, streams
from tests.fuzz.framer import frame
from tests.fuzz.seeds import CONVERSATIONS, conversation, seeds
from tests.fuzz.targets import TARGETS

STREAM = conversation(CONVERSATIONS["settings"])
SPOILT = 4  # number of the packet that is spoilt below
NASTY = b"0123456789-+ .eE^HBxX\x00\n\xff"


@pytest.mark.parametrize(
    ("target", "name"), [(target, name) for target in TARGETS for name in seeds(target)]
)
def test_a_seed_has_the_property_of_its_target(target: str, name: str) -> None:
    """The claim is the first paragraph of the target's module."""
    importlib.import_module(f"tests.fuzz.{target}").check(seeds(target)[name])


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_lists_its_needs_and_has_seeds_that_fit(target: str) -> None:
    """The fuzzer cuts longer seeds off, which would make something else of them."""
    module = importlib.import_module(f"tests.fuzz.{target}")
    assert all(len(seed) <= module.MAX_BYTES for seed in seeds(target).values())
    assert callable(module.check)


@pytest.mark.parametrize("name", CONVERSATIONS)
def test_the_reference_takes_the_packets_before_the_first_wrong_character(name: str) -> None:
    """Whatever one character is spoiled, packets before it count, and none from it on."""
    stream = conversation(CONVERSATIONS[name])
    whole = frame(stream)
    for at in range(0, len(stream), 11):
        spoiled = frame(stream[:at] + b"x" + stream[at + 1 :])
        before = max(0, at // 63 - 1)
        assert spoiled.packets == whole.packets[:before]
        assert spoiled.closed


def corrupt_streams() -> Iterator[bytes]:
    """Yield the stream with one packet that cannot be another one, whatever its numbers are."""
    first = SPOILT * PACKET_CHARS
    for at in range(first, first + PACKET_CHARS):
        for byte in (b"x", b"E"):  # the end of a number for VAL, and a power of ten
            yield STREAM[:at] + byte + STREAM[at + 1 :]
    for at in range(first, first + 6):  # IDs are consecutive
        yield STREAM[:at] + b"%d" % ((STREAM[at] - ord("0") + 1) % 10) + STREAM[at + 1 :]
    for frame_number in range(9):
        at = first + frame_number * FRAME_STRIDE
        for lost in range(1, min(8, 9 - frame_number) + 1):
            yield STREAM[:at] + STREAM[at + lost * FRAME_STRIDE :]
        for digit in range(5, 10) if frame_number else ():  # only an ID begins like that
            yield STREAM[:at] + b"%d00000" % digit + STREAM[at + 6 :]


def test_a_corrupt_packet_ends_the_connection_after_the_packets_before_it() -> None:
    """Every position and every field, in the reference and in the program that ships."""
    whole = frame(STREAM)
    for stream in corrupt_streams():
        framed = frame(stream)
        assert (framed.packets, framed.closed) == (whole.packets[: SPOILT - 1], True)
        receiver.check(b"\x03" + stream)


@settings(max_examples=100)
@given(
    at=st.integers(0, len(STREAM)),
    drop=st.integers(0, 2 * PACKET_CHARS),
    insert=st.lists(st.sampled_from(NASTY), max_size=2 * PACKET_CHARS).map(bytes),
)
def test_the_program_finds_no_new_start_after_lost_or_inserted_bytes(
    at: int, drop: int, insert: bytes
) -> None:
    """It receives what the reference receives, also where a byte is replaced by another one."""
    receiver.check(b"\x03" + STREAM[:at] + insert + STREAM[at + drop :])
    receiver.check(b"\x03" + STREAM[:at] + insert[:1] + STREAM[at + 1 :])


def test_mutations_are_streams_that_mostly_go_deep() -> None:
    """The fuzzer's changes keep enough valid packets to reach the code behind the framing."""
    data = seeds("receiver")["feedback"]
    valid = [
        len(frame(streams.mutate(data, 2000, seed, lambda given, _: given)[1:]).packets)
        for seed in range(200)
    ]
    assert sum(count >= 2 for count in valid) > 100
    assert any(count < len(CONVERSATIONS["feedback"]) for count in valid)
