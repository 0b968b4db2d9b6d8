"""Messages to bytes and back: one flat MessagePack map with header and body side by side.

Any language reads it with plain msgpack. Everything that comes in is bounded in size, typed and
finite, or it is refused; nothing is guessed.
"""

from typing import Any, TypeVar

import msgpack
from pydantic import ValidationError

from common.errors import MessageError, MisroutedError, first_mistake
from common.messages import Message, Record

SCHEMA_VERSION = 1
MAX_BYTES = 4096
MAX_ITEMS = 64

R = TypeVar("R", bound=Record)
M = TypeVar("M", bound=Message)


class Version(Record):
    """What stands before everything that is said.

    It carries its own address: after a hub was cut off for seconds, Zenoh has been seen to hand a
    message to the reader of another key, where most messages decode well and mean nothing.
    """

    v: int = SCHEMA_VERSION
    topic: str = ""  # key within the cell that it was written for


class Header(Version):
    """What stands before every message: who said it when, and the sensor sample behind it."""

    seq: int
    epoch: int  # random per start of the writer
    boot: str  # clock that the stamps are of
    stamp_ns: int
    sensor_stamp_ns: int | None = None
    sensor_seq: int | None = None


V = TypeVar("V", bound=Version)
HEADER_FIELDS = frozenset(Header.model_fields)


def encode(header: Header, message: Message) -> bytes:
    """Return the bytes of a message under its header."""
    return pack(header.model_dump() | message.model_dump())


def decode(data: bytes, message_type: type[M], topic: str | None = None) -> tuple[Header, M]:
    """Return header and message, of one topic where it is named.

    Raise MisroutedError when the bytes do not say that they were written for that topic, and
    MessageError when they are anything else but a header and such a message.
    """
    fields = unpack(data)
    header = _of_this_version(fields, Header)
    if topic is not None:
        _refuse_other(header, (topic,), topic)
    return header, _validate(fields, message_type)


def encode_record(record: Record, topic: str = "") -> bytes:
    """Return the bytes of a request, with the key that it is for, or of a reply: no header."""
    return pack(Version(topic=topic).model_dump() | record.model_dump())


def decode_record(data: bytes, record_type: type[R], topic: str = "") -> R:
    """Return a request or a reply.

    Raise MisroutedError when the bytes say that they are for another key, MessageError when they
    are anything else. A client of somebody's own need not say what its request is for.
    """
    fields = unpack(data)
    version = _of_this_version(fields, Version)
    if topic:
        _refuse_other(version, ("", topic), topic)
    return _validate(fields, record_type)


def pack(fields: dict[str, Any]) -> bytes:
    """Return the bytes of fields as they stand. Raise MessageError when they do not fit."""
    try:
        data: bytes = msgpack.packb(fields)
    except OverflowError as error:
        raise MessageError("a number of more than 64 bits") from error
    if len(data) > MAX_BYTES:
        raise MessageError(f"message of {len(data)} bytes, the limit is {MAX_BYTES}")
    return data


def unpack(data: bytes) -> dict[str, Any]:
    """Return the fields that somebody sent. Raise MessageError where it is no map in bounds."""
    if len(data) > MAX_BYTES:
        raise MessageError(f"message of {len(data)} bytes, the limit is {MAX_BYTES}")
    try:
        fields = msgpack.unpackb(
            data,
            use_list=False,
            max_array_len=MAX_ITEMS,
            max_map_len=MAX_ITEMS,
            max_bin_len=0,
            max_ext_len=0,
        )
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        raise MessageError(f"not MessagePack: {error}") from error
    if not isinstance(fields, dict):
        raise MessageError(f"a {type(fields).__name__} instead of a map of fields")
    return fields


def _of_this_version(fields: dict[str, object], head_type: type[V]) -> V:
    """Return what stands before a body; another version is told first, its head may differ."""
    version = fields.get("v", SCHEMA_VERSION)
    if type(version) is int and version != SCHEMA_VERSION:
        raise MessageError(f"schema version {version}, this program speaks {SCHEMA_VERSION}")
    return _validate(fields, head_type)


def _refuse_other(head: Version, allowed: tuple[str, ...], here: str) -> None:
    if head.topic not in allowed:
        raise MisroutedError(f"written for {head.topic[:40]!r}, and came to {here}")


def _validate(fields: dict[str, object], record_type: type[R]) -> R:
    try:
        return record_type.model_validate(fields)
    except ValidationError as error:
        first = first_mistake(error)
        code = "not_finite" if first.kind == "finite_number" else "undecodable"
        text = f"{record_type.__name__}.{first.where}: {first.what}"
        raise MessageError(text, code) from error
