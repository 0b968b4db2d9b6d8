"""Messages, requests and replies as bytes: right ones pass, and no others do."""

import math
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from forcemesh import messages as m
from forcemesh import requests as q
from forcemesh.codec import (
    MAX_BYTES,
    SCHEMA_VERSION,
    Envelope,
    Header,
    decode,
    decode_record,
    encode,
    encode_record,
    pack,
    unpack,
)
from forcemesh.errors import MessageError
from forcemesh.messages import MAX_ITEMS
from forcemesh.records import Record
from forcemesh.topics import REQUESTS, TOPICS
from tests.fakes.records import constructed, full, places, put, records

MESSAGES = sorted({topic.message for topic in TOPICS}, key=lambda t: t.__name__)
RECORDS = sorted({r.message for r in REQUESTS} | {q.Reply}, key=lambda t: t.__name__)
EVERYTHING: list[type[Record]] = [*MESSAGES, *RECORDS]
HEADER = Header(seq=7, epoch=1, boot="boot", stamp_ns=2)

each_type = pytest.mark.parametrize("record_type", EVERYTHING)

headers = records(Header).map(lambda header: header.replaced(v=SCHEMA_VERSION))

WRONG: dict[type, tuple[Any, ...]] = {
    float: ("0.5", True, None, (0.5,), {}),
    int: (7.5, "7", True, None, (7,), {}),
    bool: (1, 0.0, "true", None, ()),
    str: (7, 0.5, True, None, ("text",), {}),
    tuple: (0.5, "text", None, {}, True),
    dict: (0.5, "text", None, (), True),
}


def read(data: bytes, record_type: type[Record]) -> Record:
    """Decode bytes as the bus does for a type: messages with a header, others without."""
    if issubclass(record_type, m.Message):
        return decode(data, record_type)[1]
    return decode_record(data, record_type)


def write(record: Record) -> bytes:
    """Encode a record as the bus does: a message with a header, others without."""
    return encode(HEADER, record) if isinstance(record, m.Message) else encode_record(record)


def spelled_out(record_type: type[Record]) -> dict[str, Any]:
    """Return the fields of a record with everything in it, and its header's if it has one."""
    body: dict[str, Any] = full(record_type)
    if issubclass(record_type, m.Message):
        return {**full(Header), **body, "v": SCHEMA_VERSION}
    return {"v": SCHEMA_VERSION, **body}


def nullable(record_type: type[Record], path: tuple[str | int, ...]) -> bool:
    """Return whether None is a right value at a path: found by asking the record itself."""
    try:
        record_type.from_dict(put(full(record_type), path, None))
    except MessageError:
        return False
    return True


@each_type
@given(st.data())
def test_a_record_comes_back_as_it_was(record_type: type[Record], data: Any) -> None:
    """Every message that can exist, with its header; every request and reply."""
    record = data.draw(records(record_type))
    if isinstance(record, m.Message):
        header = data.draw(headers)
        assert decode(encode(header, record), type(record)) == (header, record)
    else:
        assert decode_record(encode_record(record), record_type) == record


@each_type
def test_first_fields_and_body_share_no_name(record_type: type[Record]) -> None:
    """One flat map has room for a name only once."""
    first = Header if issubclass(record_type, m.Message) else Envelope
    assert not set(first.__struct_fields__) & set(record_type.__struct_fields__)


@each_type
def test_a_number_that_is_not_finite_is_refused_everywhere(record_type: type[Record]) -> None:
    """Swept: every number, NaN and both infinities, by the reader and before that by the writer."""
    fields, own = spelled_out(record_type), full(record_type)
    read(msgpack.packb(fields), record_type)
    numbers = [path for path, value in places(fields) if isinstance(value, float | int)]
    for path in numbers:
        for bad in (math.nan, math.inf, -math.inf):
            with pytest.raises(MessageError):
                read(msgpack.packb(put(fields, path, bad)), record_type)
            if path[0] in own:  # a constructor checks nothing
                with pytest.raises(MessageError, match=str(path[0])):
                    write(constructed(record_type, put(own, path, bad)))


def rotations(record_type: type[Record]) -> list[tuple[str | int, ...]]:
    """Return the places of all rotations of a record, at any depth: four numbers each."""
    found = places(spelled_out(record_type))
    four = [(path, value) for path, value in found if isinstance(value, tuple) and len(value) == 4]
    return [path for path, value in four if all(isinstance(part, float) for part in value)]


TURNING = [record_type for record_type in EVERYTHING if rotations(record_type)]
NO_ROTATIONS = [
    (0.0, 0.0, 0.0, 0.0),
    (5e-324, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 2.0),
    (0.0, 0.0, 0.9989, 0.0),
    (0.0, -1.0011, 0.0, 0.0),
    (0.5, 0.5, 0.5, 0.54),
    (1e308, 1e308, 1e308, 1e308),
]


@pytest.mark.parametrize("record_type", TURNING)
def test_a_quaternion_that_is_not_of_unit_length_is_refused_everywhere(
    record_type: type[Record],
) -> None:
    """Swept: read from bytes and published; the text names the field and the length found."""
    fields = spelled_out(record_type)
    for path in rotations(record_type):
        for bad in NO_ROTATIONS:
            wrong = put(fields, path, bad)
            with pytest.raises(MessageError, match=rf"{path[-1]}: the quaternion .* has length "):
                read(msgpack.packb(wrong), record_type)
            with pytest.raises(MessageError, match=rf"{path[-1]}: the quaternion .* has length "):
                write(constructed(record_type, put(full(record_type), path, bad)))


@pytest.mark.parametrize("record_type", TURNING)
def test_a_rounded_quaternion_is_normalised_everywhere(record_type: type[Record]) -> None:
    """Three digits are a rotation; later arithmetic meets unit quaternions only."""
    for path in rotations(record_type):
        rounded = put(spelled_out(record_type), path, (0.0, 0.6005, 0.0, 0.8))
        values = dict(places(read(msgpack.packb(rounded), record_type).as_dict()))
        assert math.hypot(*values[path]) == pytest.approx(1.0, abs=1e-15)
        assert values[path][1] / values[path][3] == pytest.approx(0.6005 / 0.8, rel=1e-15)


@each_type
def test_a_value_of_another_type_is_refused_everywhere(record_type: type[Record]) -> None:
    """Swept: every field, container and entry; nothing is converted at the entry."""
    fields = spelled_out(record_type)
    own = {name: value for name, value in fields.items() if name in record_type.__struct_fields__}
    for path, value in places(own):
        for bad in WRONG[type(value)]:
            if bad is None and nullable(record_type, path):
                continue
            if bad in ({}, ()) and path[-1] in {"status", "counters", "trips", "not_ready"}:
                continue  # may be empty
            with pytest.raises(MessageError, match=str(path[0])):
                read(msgpack.packb(put(fields, path, bad)), record_type)


@pytest.mark.parametrize(
    ("field", "value", "mistake"),
    [
        ("law", "plain\n", "must be at most 31 lower-case letters"),
        ("setpoint_N", -1.0, "must be at least 0 N, found -1 N"),
        ("mode", "push", "must be 'position', 'orientation' or 'both', found 'push'"),
        ("axes", (True,) * 5, "must hold 6 values"),
    ],
)
def test_a_value_outside_its_bounds_is_refused_in_words(
    field: str, value: Any, mistake: str
) -> None:
    """With its place; Python's `$` matches before a line break as well."""
    with pytest.raises(MessageError, match=rf"^ForceStartRequest\.{field}: {mistake}"):
        read(msgpack.packb({"mode": "position", field: value}), q.ForceStartRequest)


def test_an_entry_of_a_map_is_named() -> None:
    """Counters and measured numbers are found by their names."""
    fields = spelled_out(m.Health)
    for name, value, what in (
        ("counters", 1.5, "must be a whole number, found 1.5"),
        ("numbers", math.nan, "must be a finite number, found nan"),
        ("numbers", "1", "must be a number, found '1'"),
    ):
        data = msgpack.packb(fields | {name: {"right": 1, "wrong": value}})
        with pytest.raises(MessageError, match=rf"^Health\.{name}\.wrong: {what}"):
            read(data, m.Health)


@pytest.mark.parametrize(
    ("message", "field", "value", "mistake"),
    [
        *((m.Health, "fault", each, "Health") for each in (object(), np.zeros(3))),
        (m.Health, "fault", "\udc80", "not a text"),
        (m.WrenchAtTcp, "force_N", "\udc80", "not a text"),
        (m.WrenchAtTcp, "force_N", object(), "WrenchAtTcp"),
        (
            m.WrenchAtTcp,
            "force_N",
            (10**400, 0.0, 0.0),
            r"force_N\.0: number out of range, found 1",
        ),
        (m.Health, "counters", {"dropped": 2**64}, "64 bits"),
        (m.ArbiterStatus, "not_ready", ("x" * 500,) * 9, "the limit is"),
    ],
)
def test_what_has_no_form_on_the_bus_is_not_sent(
    message: type[m.Message], field: str, value: Any, mistake: str
) -> None:
    """The writer gets the one error that it expects, not the readers."""
    with pytest.raises(MessageError, match=mistake):
        encode(HEADER, message(**{field: value}))


def test_numbers_of_numpy_are_numbers() -> None:
    """Computed values need no conversion; what is sent are plain floats."""
    sent = encode(HEADER, m.WrenchAtTcp(force_N=(np.float64(1.0), 2, 3.0)))
    assert sent == encode(HEADER, m.WrenchAtTcp(force_N=(1.0, 2.0, 3.0)))


@each_type
def test_a_field_that_must_be_there_is_missed(record_type: type[Record]) -> None:
    """Every field without a default is asked for by name."""
    fields = spelled_out(record_type)
    needed = [field.name for field in structs.fields(record_type) if field.required]
    if issubclass(record_type, m.Message):
        needed += [field.name for field in structs.fields(Header) if field.required]
    for name in needed:
        rest = {key: value for key, value in fields.items() if key != name}
        with pytest.raises(MessageError, match=f"{name}: missing"):
            read(msgpack.packb(rest), record_type)


@each_type
@given(data=st.data())
def test_one_changed_byte_is_refused_or_right(record_type: type[Record], data: Any) -> None:
    """A damaged message never becomes one with a number that is not finite."""
    good = bytearray(msgpack.packb(spelled_out(record_type)))
    good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    try:
        record = read(bytes(good), record_type)
    except MessageError:
        return
    assert record_type.from_dict(record.as_dict()) == record


@each_type
def test_too_many_bytes_are_refused_unread(record_type: type[Record]) -> None:
    """The limit is checked before anything is unpacked, and it is exact."""
    fields = spelled_out(record_type)
    spare = MAX_BYTES - len(msgpack.packb({**fields, "more": "x" * 300})) + 300
    read(msgpack.packb({**fields, "more": "x" * spare}), record_type)
    with pytest.raises(MessageError, match=rf"{MAX_BYTES + 1} bytes, the limit is {MAX_BYTES}"):
        read(msgpack.packb({**fields, "more": "x" * (spare + 1)}), record_type)


@each_type
def test_deep_and_wide_nesting_is_refused(record_type: type[Record]) -> None:
    """A bomb of containers costs an error message, no more."""
    fields = msgpack.packb(spelled_out(record_type))
    for bomb in (b"\x91" * 2000, b"\xdc\xff\xff", b"\xde\xff\xff", b"\xdd\x7f\xff\xff\xff"):
        with pytest.raises(MessageError):
            read(bomb, record_type)
        with pytest.raises(MessageError):
            read(bytes([fields[0] + 1]) + fields[1:] + b"\xa3new" + bomb, record_type)
    with pytest.raises(MessageError):
        read(msgpack.packb({f"k{i}": i for i in range(MAX_ITEMS + 1)}), record_type)
    with pytest.raises(MessageError):
        read(msgpack.packb({"new": (0,) * (MAX_ITEMS + 1)}), record_type)


@each_type
def test_unknown_fields_are_ignored(record_type: type[Record]) -> None:
    """A newer writer may add fields; those that an older reader knows still arrive."""
    fields = spelled_out(record_type)
    more = {**fields, "new_field": {"a": (1, 2.5, "b")}}

    assert read(msgpack.packb(more), record_type) == read(msgpack.packb(fields), record_type)


@each_type
def test_another_schema_version_is_refused(record_type: type[Record]) -> None:
    """Two programs of different versions report that, in messages and in requests."""
    fields = spelled_out(record_type)
    for version in (0, SCHEMA_VERSION + 1, -1):
        with pytest.raises(MessageError, match=f"schema version {version}"):
            read(msgpack.packb({**fields, "v": version}), record_type)
    for no_version in (True, 1.5, "1", None):
        with pytest.raises(MessageError):
            read(msgpack.packb({**fields, "v": no_version}), record_type)


def test_a_payload_of_4096_bytes_is_the_largest_one() -> None:
    """At the writer and at both readers; a request without an envelope is of an unknown age."""
    fixed = len(pack({"more": "x" * 300})) - 300
    largest = {"more": "x" * (4096 - fixed)}
    assert unpack(pack(largest)) == largest
    with pytest.raises(MessageError, match="4097 bytes"):
        pack({"more": largest["more"] + "x"})
    assert (Envelope().stamp_ns, Envelope().status_epoch, Envelope().status_seq) == (0, 0, 0)
    assert (Envelope().wait_s, SCHEMA_VERSION, MAX_BYTES) == (0.5, 3, 4096)
