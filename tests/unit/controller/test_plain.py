"""Protocol plain: the specification's characters, any chunking, and nothing malformed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.doctor.remedies import FAULTS
from controller.packet import Packet
from controller.packet_table import TABLE, Com
from controller.plain import (
    COMMANDS,
    ID_LAST,
    KEPT_FAULTS,
    NOT_PROTECTED,
    PROGRAM,
    REPORTS,
    Controller,
    PlainReader,
    PlainSection,
    encode,
    program,
)
from forcemesh.errors import LocalProtocolError, RemoteProtocolError

values = st.integers(-99_999, 999_999)
reports = st.builds(
    Packet, st.integers(1, ID_LAST), st.sampled_from(REPORTS), st.just(0), st.tuples(*[values] * 6)
)
widths = st.sampled_from([54, 63])
NUMBERS = (1, 101, 0, 123, -123, 0, 999_999, -99_999, 5)
SPACED = "000001 000101 000000 000123 -00123 000000 999999 -99999 000005 "


def test_the_characters_are_those_of_the_specification() -> None:
    """Every number takes six characters, filled with zeros: 123 is 000123."""
    packet = Packet(1, 101, 0, (123, -123, 0, 999_999, -99_999, 5))
    assert packet.frames == NUMBERS
    assert encode(packet, 63).decode() == SPACED
    assert encode(packet, 54).decode() == SPACED.replace(" ", "")


@given(packets=st.lists(reports, max_size=4), chars=widths, cut=st.integers(1, 70))
def test_what_is_encoded_is_read_back_however_it_is_cut(packets, chars, cut) -> None:
    """A packet is taken as soon as its characters are there."""
    data = b"".join(encode(packet, chars) for packet in packets)
    reader, read = PlainReader(chars), []
    for start in range(0, len(data), cut):
        read += reader.feed(data[start : start + cut])
    assert read == packets


@pytest.mark.parametrize("value", [-100_000, 1_000_000])
def test_a_number_that_does_not_fit_is_refused(value: int) -> None:
    """Never clipped; the frame is named."""
    with pytest.raises(LocalProtocolError, match=rf"Vec3 is {value}, it must be -99999 to 999999"):
        encode(Packet(1, 1, 0, (0, 0, value, 0, 0, 0)), 63)
    with pytest.raises(LocalProtocolError, match="ID is 0, it must be 1 to 999999"):
        encode(Packet(0, 1), 54)


@pytest.mark.parametrize(
    "text",
    [
        SPACED.replace("000005 ", "000005x"),
        SPACED.replace("000123", "00012x"),
        SPACED.replace("000123", "+00123"),
        SPACED.replace(" 000101 000000", " 000101 000001"),
        SPACED.replace("000101", "000103"),
        SPACED.replace("000001", "-00001", 1),
    ],
)
def test_anything_but_a_report_ends_the_stream(text: str) -> None:
    """Wrong characters, another Com, Param, or ID; then every call fails."""
    reader = PlainReader(63)
    for data in (text.encode(), b""):
        with pytest.raises(RemoteProtocolError, match=r"gateway\.plain\.packet_chars"):
            reader.feed(data)


def test_units_are_those_of_the_section_for_every_number_of_the_table() -> None:
    """1 without a setting: mm, degrees, N, N m, mm/s, percent, and gains in these."""
    plain = PlainSection()
    numbers = [n for com in (*COMMANDS, *REPORTS) for vector in TABLE[com].vectors for n in vector]
    assert {plain.units(number) for number in numbers} == {1}
    finer = PlainSection(gain_i=7, gain_p=5, per_percent=3, torque_per_Nm=2)
    assert [finer.units(TABLE[Com.GAINS].numbers(param)[0]) for param in (0, 1)] == [5, 7]
    assert finer.units(TABLE[Com.SPEEDS].numbers(0)[0]) == 3


def test_the_program_gets_the_numbers_of_a_cell_and_no_other_change() -> None:
    """Each line of pl.config that the cell file decides, once."""
    text = PROGRAM.read_text(encoding="ascii")
    plain = PlainSection(packet_chars=54, position_per_mm=50, gain_i=5000)
    made = program(plain, Controller(50000, (0.0, -12.5, 160.0), 0.04, 2.0, (370.0, *[500.5] * 5)))
    changed = [line for line in made.splitlines() if line not in text.splitlines()]
    assert [line.split(" ;")[0].strip() for line in changed] == [
        "pl.port=50000", "pl.w=6", "pl.sp=50", "pl.si=5000", "pl.ty=-12.5", "pl.tz=160",
        "pl.tmove=0.04", "pl.vmin=2", *(f"pl.jmax[{k}]=500.5" for k in range(2, 7)),
    ]  # fmt: skip
    assert program(PlainSection(), Controller()) == text


def test_every_protection_that_plain_lacks_is_listed_or_kept() -> None:
    """Each fault that forcemesh.as can report is one that plain.as has as well, or of a row."""
    lacking = [fault for row in NOT_PROTECTED for fault in row.faults]
    assert sorted((*lacking, *KEPT_FAULTS)) == sorted(FAULTS)
