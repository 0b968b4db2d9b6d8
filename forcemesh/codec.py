"""Messages to bytes and back: one flat MessagePack map with header and body side by side.

Any language reads it with plain msgpack. Everything that comes in is bounded in size, typed and
finite, or it is refused; nothing is guessed.
"""

from functools import lru_cache
from typing import Any, TypeVar

import msgpack
from pydantic import ValidationError

from forcemesh.errors import MessageError, MisroutedError, first_mistake
from forcemesh.messages import Message, Record

SCHEMA_VERSION = 2  # 2: an address names the cell too; 1: the key alone
RECORDED_VERSIONS = (1, SCHEMA_VERSION)  # which recordings still open
MAX_BYTES = 4096
MAX_ITEMS = 64

R = TypeVar("R", bound=Record)
M = TypeVar("M", bound=Message)


class Version(Record):
    """First fields of every message, request and reply: schema version and address.

    After a hub was cut off for seconds, Zenoh has been seen to deliver a message to the reader of
    another key. Most messages decode there as well, and one of another cell always does.
    """

    v: int = SCHEMA_VERSION
    topic: str = ""  # address it was written for: <cell>/<key>


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
    return pack(vars(header) | message.model_dump())  # a header is flat


@lru_cache(maxsize=64)
def decode(data: bytes, message_type: type[M], address: str | None = None) -> tuple[Header, M]:
    """Return header and message, of one address `<cell>/<key>` where it is named.

    Both are values: readers of one process (several roles may share it) share what one has read.

    Raise MisroutedError when the bytes do not say that they were written for that address, and
    MessageError when they are anything else but a header and such a message.
    """
    fields = unpack(data)
    header = _of_this_version(fields, Header)
    if address is not None:
        _refuse_other(header, (address,), address)
    return header, _validate(fields, message_type)


def decode_recorded(data: bytes, message_type: type[M], key: str) -> tuple[Header, M]:
    """Return header and message of a recording, of this schema version or of an older one.

    Raise MisroutedError when they were written for another key, of whichever cell, and
    MessageError as `decode` does.
    """
    fields = unpack(data)
    header = _of_this_version(fields, Header, RECORDED_VERSIONS)
    written_for = header.topic if header.v == 1 else header.topic.partition("/")[2]
    if written_for != key:
        raise MisroutedError(f"written for {header.topic[:80]!r}, and recorded as {key}")
    return header, _validate(fields, message_type)


def readdressed(data: bytes, address: str) -> bytes:
    """Return a recorded message as it is published now under an address.

    Other fields keep their values; bytes that need no change, or are no message, stay as they are.
    """
    try:
        fields = unpack(data)
    except MessageError:
        return data
    now = {"v": SCHEMA_VERSION, "topic": address}
    if fields.get("v") not in RECORDED_VERSIONS or fields | now == fields:
        return data
    return pack(fields | now)


def encode_record(record: Record, address: str = "") -> bytes:
    """Return the bytes of a request, with the address that it is for, or of a reply: no header."""
    return pack(Version(topic=address).model_dump() | record.model_dump())


def decode_record(data: bytes, record_type: type[R], address: str = "") -> R:
    """Return a request or a reply.

    Raise MisroutedError when the bytes say that they are for another address, MessageError when
    they are anything else. A client of one's own may leave the address of a request out.
    """
    fields = unpack(data)
    version = _of_this_version(fields, Version)
    if address:
        _refuse_other(version, ("", address), address)
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


def _of_this_version(
    fields: dict[str, object], head_type: type[V], versions: tuple[int, ...] = (SCHEMA_VERSION,)
) -> V:
    """Return what stands before a body; another version is reported first, its head may differ."""
    version = fields.get("v", SCHEMA_VERSION)
    if type(version) is int and version not in versions:
        raise MessageError(f"schema version {version}, this program speaks {SCHEMA_VERSION}")
    return _validate(fields, head_type)


def _refuse_other(head: Version, allowed: tuple[str, ...], here: str) -> None:
    if head.topic not in allowed:
        raise MisroutedError(f"written for {head.topic[:80]!r}, and came to {here}")


def _validate(fields: dict[str, object], record_type: type[R]) -> R:
    try:
        return record_type.model_validate(fields)
    except ValidationError as error:
        first = first_mistake(error)
        code = "not_finite" if first.kind == "finite_number" else "undecodable"
        text = f"{record_type.__name__}.{first.where}: {first.what}"
        raise MessageError(text, code) from error
