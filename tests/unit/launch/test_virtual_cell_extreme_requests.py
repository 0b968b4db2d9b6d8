"""Extreme requests: none ends a service or moves the arm beyond the limits of the cell file.

Every request model, every field at its extremes, in every state, against the cores of a whole cell
on a virtual clock. An unhandled error of a core is raised here and fails the test.
"""

import random
from collections.abc import Callable, Iterator
from typing import Any

import msgpack
import numpy as np
import pytest

from common.bus.memory_bus import MemoryCall
from common.motion.limits import Limits
from forcemesh import topics
from forcemesh.codec import decode_record, encode_record
from forcemesh.messages import OPERATIONAL
from forcemesh.requests import Empty, HoldRequest, Reply
from forcemesh.topics import REQUESTS
from tests.fakes.bench import CELL
from tests.fakes.lab import BRAKE_S, Lab
from tests.fakes.long import long
from tests.fakes.records import full, places, put

NUMBERS = (
    -0.0, 5e-324, 100.0, -100.0, 1e6, -1e6, 1e200, -1e200, 1e308, -1e308,
    float("inf"), float("-inf"), float("nan"), 0, 1, -1, 2**31, 2**63, 2**64 - 1, -(2**63),
)  # fmt: skip
OTHERS: tuple[Any, ...] = (None, (), (0.0,) * 64, {}, {"kind": "pose"}, True)
TEXTS = ("", "x" * 501, "x" * 3400, "\x00", "../../../etc/passwd", "\ud7ff\U0010ffff", *OTHERS)
# Of a request with several: one full body for each.
KINDS: dict[str, list[dict[str, Any]]] = {
    "request/move": [{"kind": kind} for kind in ("pose", "joints", "by")],
    "request/force/start": [{"law": law, "setpoint_N": 5.0} for law in ("plain", "adaptive")],
}
EVERY_S = 0.004  # one request in each control period
SAMPLE = 30  # of about 3000, for each state, in a quick run
LIMITS = Limits.of(CELL)
SPEED_M_S = 1.2 * CELL.limits.speed_m_s + 0.02  # of the simulated arm, with servo lag
FORCE_N = 1.3 * CELL.limits.force_N


def bodies() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every request: unchanged, then each value, and all numbers, replaced by extremes."""
    for row in REQUESTS:
        for kind in KINDS.get(row.key, [{}]):
            whole = full(row.message) | kind
            yield row.key, whole
            for path, value in places(whole):
                others = OTHERS if isinstance(value, dict | tuple) else NUMBERS
                for extreme in TEXTS if isinstance(value, str) else others:
                    yield row.key, put(whole, path, extreme)
            for number in NUMBERS:
                body = whole
                for path, value in places(whole):
                    if isinstance(value, float):
                        body = put(body, path, number)
                yield row.key, body


def hostile() -> list[tuple[str, bytes]]:
    """Return every request as bytes, whatever it contains."""
    packed = []
    for key, body in bodies():
        try:
            packed.append((key, bytes(msgpack.packb(body))))
        except (ValueError, OverflowError, UnicodeEncodeError):
            packed.append((key, b"\xc1"))
    return packed


def idle(lab: Lab) -> None:
    """Bring the arm to IDLE: held and cleared."""
    held(lab)
    assert lab.ask(topics.CLEAR, Empty()).accepted


def armed(_lab: Lab) -> None:
    """Keep the arm armed, as a lab is."""


def held(lab: Lab) -> None:
    """Hold the arm by request."""
    assert lab.ask(topics.HOLD, HoldRequest()).accepted
    lab.cell.advance(BRAKE_S)


def faulty(lab: Lab) -> None:
    """Kill a process, so that the arbiter reports FAULT."""
    lab.cell.kill("wrench")
    lab.cell.advance(0.3)
    assert lab.status.state == "FAULT"


STATES: dict[str, Callable[[Lab], None]] = {
    "IDLE": idle,
    "ARMED": armed,
    "moving": Lab.lift,
    "pressing": Lab.press,
    "HOLDING": held,
    "FAULT": faulty,
}


def send(lab: Lab, key: str, data: bytes) -> MemoryCall:
    """Queue the bytes of a request for its server."""
    call = MemoryCall(data)
    lab.cell.transport.serve(f"{CELL.cell}/{key}").waiting.append(call)
    return call


def send_all(lab: Lab, requests: list[tuple[str, bytes]]) -> None:
    """Send requests in sequence; check the simulated arm after each."""
    before_m = lab.p_m()
    for key, data in requests:
        send(lab, key, data)
        lab.cell.advance(EVERY_S)
        p_m, q = lab.p_m(), lab.q_command()
        assert np.isfinite(q).all(), (key, data)
        speed_m_s = float(np.linalg.norm(p_m - before_m)) / EVERY_S
        assert speed_m_s < SPEED_M_S, (key, data)
        tcp_m = (lab.cell.arm.T_base_flange * CELL.tool.T_flange_tcp.pose).translation
        assert (tcp_m > LIMITS.workspace_min_m - 0.01).all(), (key, data)
        assert (tcp_m < LIMITS.workspace_max_m + 0.01).all(), (key, data)
        assert abs(lab.force_N) < FORCE_N, (key, data)
        before_m = p_m


def assert_hold_works(lab: Lab) -> None:
    """Check that a hold is executed: the arm comes to rest and stays there."""
    call = send(lab, topics.HOLD.key, b"")
    lab.cell.advance(2 * EVERY_S)
    assert call.reply is not None
    assert decode_record(call.reply, Reply).accepted
    assert lab.status.state not in OPERATIONAL
    lab.cell.advance(BRAKE_S)
    lab.assert_still(0.1)


@pytest.mark.parametrize("share", ["some", long("all")])
@pytest.mark.parametrize("state", STATES)
def test_no_request_ends_a_service_or_breaks_a_limit(state: str, share: str) -> None:
    """In every state, for any request: the arm keeps its limits, and a hold works."""
    requests = hostile()
    if share == "some":
        requests = random.Random(state).sample(requests, SAMPLE)
    lab = Lab(CELL)  # a request in each of its control periods
    STATES[state](lab)
    send_all(lab, requests)
    assert_hold_works(lab)


def test_a_hold_is_served_while_every_inbox_is_full() -> None:
    """With invalid requests in every inbox the hold is executed within two periods."""
    lab = Lab()
    lab.lift()
    for row in topics.REQUESTS:
        for _ in range(16):
            send(lab, row.key, encode_record(Empty()) if row is topics.CLEAR else b"\xc1")
    lab.cell.advance(EVERY_S * 2)
    assert lab.status.state not in OPERATIONAL
    lab.cell.advance(EVERY_S * 8)  # until the queued requests are answered: a few in each period
    assert_hold_works(lab)
