"""Requests with extreme values: every number and text of every request at its ends."""

from collections.abc import Iterator
from typing import Any

import msgpack

from forcemesh.topics import REQUESTS, Request
from tests.fakes.records import full, places, put

NUMBERS = (
    0.0, -0.0, 5e-324, 1e-300, 1.0, -1.0, 100.0, -100.0, 1e6, -1e6, 1e200, -1e200, 1e308, -1e308,
    float("inf"), float("-inf"), float("nan"), 0, 1, -1, 2**31, 2**63, 2**64 - 1, -(2**63),
)  # fmt: skip
TEXTS = ("", "x" * 500, "x" * 501, "x" * 3400, "\x00", "../../../etc/passwd", "\ud7ff\U0010ffff")
OTHERS: tuple[Any, ...] = (None, (), (0.0,) * 64, {}, {"kind": "pose"}, True)


def bodies(request: Request[Any]) -> Iterator[dict[str, Any]]:
    """Yield the fields of a request: unchanged, then each value replaced by each extreme."""
    for whole in _whole(request):
        yield whole
        for path, value in places(whole):
            if isinstance(value, dict | tuple):
                extremes: tuple[Any, ...] = OTHERS
            elif isinstance(value, str):
                extremes = (*TEXTS, *OTHERS)
            else:
                extremes = NUMBERS
            for extreme in extremes:
                yield put(whole, path, extreme)
        for number in NUMBERS:  # all of them at once
            body = whole
            for path, value in places(whole):
                if isinstance(value, float):
                    body = put(body, path, number)
            yield body


def _whole(request: Request[Any]) -> Iterator[dict[str, Any]]:
    """Yield one full body for each kind of a request."""
    body = full(request.message)
    if request.key == "request/move":
        for kind in ("pose", "joints", "by"):
            yield body | {"kind": kind}
    elif request.key == "request/force/start":
        for law in ("plain", "adaptive", "admittance"):
            yield body | {"law": law, "setpoint_N": 5.0}
    else:
        yield body


def packed(body: dict[str, Any]) -> bytes:
    """Return a body as bytes, whatever it contains."""
    try:
        return bytes(msgpack.packb(body))
    except (ValueError, OverflowError, UnicodeEncodeError):
        return b"\xc1"


def hostile() -> list[tuple[str, bytes]]:
    """Return every hostile request: its key and its bytes."""
    return [(row.key, packed(body)) for row in REQUESTS for body in bodies(row)]
