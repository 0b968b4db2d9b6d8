"""Message codec: one flat MessagePack map with header and body side by side.

Any language reads it with plain msgpack. Input that is not bounded in size, of the right type and
finite is rejected.
"""

from typing import Annotated, Any, TypeVar

import msgpack
import msgspec
from msgspec import Meta
from msgspec.structs import asdict

from forcemesh.errors import MessageError, MisroutedError
from forcemesh.messages import MAX_ITEMS, Message
from forcemesh.records import Record, normalise_rotations

SCHEMA_VERSION = 3  # forcemesh/recorded_messages.py has the history
MAX_BYTES = 4096
SHORTEST_WAIT_S = 0.5  # of a client for its reply

MISTAKES = (msgspec.MsgspecError, ArithmeticError, RecursionError, TypeError, ValueError)
_ENCODER = msgspec.msgpack.Encoder(enc_hook=float)  # numpy's floats

R = TypeVar("R", bound=Record)
M = TypeVar("M", bound=Message)


class Version(Record):
    """First fields of every message, request and reply: schema version and address.

    After a hub was disconnected for seconds, Zenoh was observed to deliver a message to the reader
    of another key. Most messages decode there as well, and one of another cell always does.
    """

    v: int = SCHEMA_VERSION
    topic: str = ""  # address of publication: <cell>/<key>


class Header(Version):
    """Header of every message: publisher, time, and the sensor sample it is based on."""

    seq: int
    epoch: int  # random number per start of the publisher
    boot: str  # identity of the clock of the stamps
    stamp_ns: int
    sensor_stamp_ns: int | None = None
    sensor_seq: int | None = None


class Envelope(Version):
    """First fields of a request. A third-party client may omit each of them."""

    sender: str = ""  # program, process and host, by its own account
    client: str = ""  # owner of what it starts, by its own account
    boot: str = ""  # identity of the clock of the stamp; empty: the age is unknown
    stamp_ns: int = 0  # when it was sent
    # How long the client waits for the reply; a request that is older is not executed.
    wait_s: Annotated[float, Meta(gt=0.0, le=3600.0)] = SHORTEST_WAIT_S
    # Newest health of the server that the client has received: its age is that of a request from
    # another clock.
    status_epoch: int = 0
    status_seq: int = 0


def encode(header: Header, message: Message) -> bytes:
    """Return the bytes of a header and a message. Raise MessageError when a value is wrong."""
    try:  # a constructor checks nothing
        checked = msgspec.msgpack.decode(_ENCODER.encode(message), type=type(message))
        normalise_rotations(checked)
    except MISTAKES:
        checked = message.from_dict(message.as_dict())
    return pack(asdict(header) | asdict(checked))


def decode(data: bytes, message_type: type[M], address: str | None = None) -> tuple[Header, M]:
    """Return header and message; check the address `<cell>/<key>` if one is named.

    Raise MisroutedError when the bytes carry another address, and MessageError when they are not a
    header and a message of this type.
    """
    if len(data) <= MAX_BYTES:
        try:
            header = msgspec.msgpack.decode(data, type=Header)
            if header.v == SCHEMA_VERSION and address in (None, header.topic):
                message = msgspec.msgpack.decode(data, type=message_type)
                return header, normalise_rotations(message)
        except MISTAKES:
            pass
    fields = unpack(data)  # more slowly, with the field that is wrong
    header = Header.from_dict(fields)
    if address is not None and header.topic != address:
        raise misrouted(header, address)
    return header, message_type.from_dict(fields)


def encode_record(record: Record, head: Version | None = None) -> bytes:
    """Return the bytes of a reply, or of a request with its envelope."""
    checked = record.from_dict(record.as_dict())
    return pack(asdict(head or Version()) | asdict(checked))


def decode_record(data: bytes, record_type: type[R]) -> R:
    """Return a request or a reply. Raise MessageError when the bytes are not such a record."""
    fields = unpack(data)
    Version.from_dict(fields)
    return record_type.from_dict(fields)


def decode_envelope(data: bytes, address: str) -> Envelope:
    """Return the first fields of a request.

    Raise MisroutedError when they carry another address, MessageError when one of them is wrong.
    """
    envelope = Envelope.from_dict(unpack(data))
    if envelope.topic not in ("", address):
        raise misrouted(envelope, address)
    return envelope


def pack(fields: dict[str, Any]) -> bytes:
    """Return the bytes of fields. Raise MessageError when they do not fit."""
    try:
        data = msgspec.msgpack.encode(fields)
    except OverflowError as error:
        raise MessageError("a number of more than 64 bits") from error
    except UnicodeEncodeError as error:
        raise MessageError(f"not a text: {error}") from error
    if len(data) > MAX_BYTES:
        raise MessageError(f"message of {len(data)} bytes, the limit is {MAX_BYTES}")
    return data


def unpack(data: bytes, versions: tuple[int, ...] = (SCHEMA_VERSION,)) -> dict[str, Any]:
    """Return the fields of a payload.

    Raise MessageError when it is not a map within bounds, or of another schema version: that is
    reported before any field, because they may differ.
    """
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
    version = fields.get("v", SCHEMA_VERSION)
    if type(version) is int and version not in versions:
        raise MessageError(f"schema version {version}, this program uses {SCHEMA_VERSION}")
    return fields


def misrouted(head: Version, here: str) -> MisroutedError:
    """Return the error of a payload that carries another address than the one of its arrival."""
    return MisroutedError(f"addressed to {head.topic[:80]!r}, but received on {here}")
