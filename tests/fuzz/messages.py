"""Fuzz target `messages`: any bytes on the bus decode to a valid message, or MessageError.

The first byte selects the topic or the request.
"""

import random
from collections.abc import Callable
from functools import cache
from typing import Any

import msgpack

from forcemesh.codec import decode, decode_record, encode, encode_record
from forcemesh.errors import MessageError
from forcemesh.messages import Message
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.topics import REQUESTS, TOPICS
from tests.fuzz.seeds import seeds

MAX_BYTES = 4200  # slightly more than the limit of a message
MESSAGES: tuple[type[Message], ...] = tuple(topic.message for topic in TOPICS)
RECORDS: tuple[type[Record], ...] = (*(request.message for request in REQUESTS), Reply)
ODD: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2**63, -(2**63), 2**64 - 1, 0.0, -0.0, 1e308, float("nan"), float("inf"),
    "", "text", "\ud7ff\U0010ffff", b"", (), (0.0,) * 3, (1.0,) * 6, ("a",) * 65, {}, {"v": 1},
)  # fmt: skip


def mutate(data: bytes, max_size: int, seed: int, plain: Callable[[bytes, int], bytes]) -> bytes:
    """Mutate at field level, occasionally at byte level.

    The fuzzer has no coverage of msgpack and msgspec and discards long inputs: most mutations
    start from a seed.
    """
    rng = random.Random(seed)
    if rng.random() < 0.8:
        data = rng.choice(_starts())
    try:
        fields = msgpack.unpackb(data[1:], use_list=True)
    except (ValueError, TypeError, msgpack.UnpackException):
        return plain(data, max_size)
    if not isinstance(fields, dict) or not fields or rng.random() < 0.2:
        return plain(data, max_size)
    for _ in range(rng.randint(1, 3)):
        _change(fields, rng)
    head = data[:1] if rng.random() < 0.9 else bytes((rng.randrange(256),))
    try:
        packed: bytes = msgpack.packb(fields)
    except (ValueError, OverflowError, TypeError):
        return plain(data, max_size)
    return (head + packed)[:max_size]


@cache
def _starts() -> tuple[bytes, ...]:
    return tuple(seeds("messages").values())


def _change(fields: dict[Any, Any], rng: random.Random) -> None:
    """Change the value of a field or nested field; rename, drop or add one."""
    key = rng.choice(list(fields)) if fields else "v"
    inner = fields.get(key)
    if isinstance(inner, dict) and rng.random() < 0.6:
        _change(inner, rng)
    elif isinstance(inner, list) and inner and rng.random() < 0.6:
        inner[rng.randrange(len(inner))] = rng.choice(ODD)
    elif rng.random() < 0.1:
        fields.pop(key, None)
    elif rng.random() < 0.1:
        fields[rng.choice(("v", "extra", ""))] = rng.choice(ODD)
    elif isinstance(inner, float) and rng.random() < 0.6:
        fields[key] = inner * rng.choice((-1.0, 1e300, 1e-300, 1.5))
    else:
        fields[key] = rng.choice(ODD)


def check(data: bytes) -> None:
    """Decode bytes; a decoded message must round-trip."""
    if not data:
        return
    choice, body = data[0] % (len(MESSAGES) + len(RECORDS)), data[1:]
    try:
        if choice < len(MESSAGES):
            _check_message(body, MESSAGES[choice])
        else:
            _check_record(body, RECORDS[choice - len(MESSAGES)])
    except MessageError as error:
        assert str(error)


def _check_message(body: bytes, kind: type[Message]) -> None:
    header, message = decode(body, kind)
    again = encode(header, message)
    assert decode(again, kind) == (header, message)


def _check_record(body: bytes, kind: type[Record]) -> None:
    record = decode_record(body, kind)
    assert decode_record(encode_record(record), kind) == record
