"""TCP instructions: argument order, ranges, and result variables."""

from collections.abc import Callable, Sequence
from typing import Any

from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.values import NUMBER, Value
from sim.controller.instruction import Action, until
from sim.controller.motion_requests import checked
from sim.controller.tasks import Task, Wait
from sim.controller.tcp import (
    ABORTED,
    DEFAULT_TIMEOUT_S,
    ELEMENT_CHARS,
    PORTS,
    Operation,
    TcpResult,
)

_MOST_ELEMENTS = 4096
_LONGEST_TIMEOUT_S = 3600.0

Store = Callable[[Task, float], None]
StoreRow = Callable[[Task, Sequence[Value]], None]
ReadRow = Callable[[Task, int], list[Value]]


def listen(task: Task, store: Store, port: float) -> None:
    """TCP_LISTEN ret,port."""
    store(task, task.hardware.tcp.listen(_port(port)))


def end_listen(task: Task, store: Store, port: float) -> None:
    """TCP_END_LISTEN ret,port."""
    store(task, task.hardware.tcp.end_listen(_port(port)))


def close(task: Task, store: Store, number: float) -> None:
    """TCP_CLOSE ret,socket."""
    store(task, task.hardware.tcp.close(int(number)))


def accept(
    task: Task,
    store: Store,
    port: float,
    timeout_s: float = DEFAULT_TIMEOUT_S,
    store_peer: StoreRow | None = None,
) -> Wait | None:
    """TCP_ACCEPT socket,port[,timeout[,ip[k]]]."""

    def finish(outcome: TcpResult) -> None:
        if store_peer is not None and outcome.code > 0:
            store_peer(task, [float(octet) for octet in outcome.peer])

    end_ns = _end_ns(task, timeout_s)
    return _wait_for(task, store, task.hardware.tcp.accept(_port(port), end_ns), finish)


def connect(
    task: Task, store: Store, port: float, peer: ReadRow, timeout_s: float = DEFAULT_TIMEOUT_S
) -> Wait | None:
    """TCP_CONNECT socket,port,ip[k][,timeout]."""
    octets = _row(peer(task, 4), NUMBER, "TCP_CONNECT needs numbers")
    a, b, c, d = (int(checked(octet, 0, 255, "an octet of ip")) for octet in octets)
    number = int(checked(port, 1, 65535, "port"))
    operation = task.hardware.tcp.connect((a, b, c, d), number, _end_ns(task, timeout_s))
    return _wait_for(task, store, operation)


def send(
    task: Task,
    store: Store,
    number: float,
    elements: ReadRow,
    count: float,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> Wait | None:
    """TCP_SEND ret,socket,$a[k],n[,timeout]."""
    n = int(checked(count, 1, _MOST_ELEMENTS, "the number of elements"))
    strings = _row(elements(task, n), str, "TCP_SEND needs strings")
    operation = task.hardware.tcp.send(int(number), strings, _end_ns(task, timeout_s))
    return _wait_for(task, store, operation)


def receive(
    task: Task,
    store: Store,
    number: float,
    store_text: StoreRow,
    store_count: Store,
    timeout_s: float = DEFAULT_TIMEOUT_S,
    longest: float = float(ELEMENT_CHARS),
) -> Wait | None:
    """TCP_RECV ret,socket,$a[k],n[,timeout[,maxlen]]; n receives the count."""

    def finish(outcome: TcpResult) -> None:
        store_count(task, len(outcome.elements))
        store_text(task, outcome.elements)

    chars = int(checked(longest, 1, ELEMENT_CHARS, "the longest element"))
    end_ns = _end_ns(task, timeout_s)
    operation = task.hardware.tcp.receive(int(number), end_ns, longest=chars)
    return _wait_for(task, store, operation, finish)


def _port(value: float) -> int:
    return int(checked(value, PORTS.start, PORTS.stop - 1, "port"))


def _end_ns(task: Task, timeout_s: float) -> int:
    asked_s = checked(timeout_s, 0.0, _LONGEST_TIMEOUT_S, "the time-out")
    hardware = task.hardware
    return hardware.now_ns + round(hardware.behaviour.timeout_s(asked_s) * NS_PER_S)


def _row(values: list[Any], kind: type | tuple[type, ...], reason: str) -> list[Any]:
    if all(isinstance(value, kind) for value in values):
        return values
    raise AsError("P0118", reason)


def _wait_for(
    task: Task,
    store: Store,
    operation: Operation,
    finish: Callable[[TcpResult], None] = lambda _: None,
) -> Wait | None:
    """Store the code as soon as the operation has completed; until then, poll it.

    Raises AsError E4025 for a broken connection where that is a standing error.
    """

    def ends(now_ns: int) -> bool:
        outcome = operation(now_ns)
        if outcome is None:
            return False
        store(task, outcome.code)
        finish(outcome)
        if outcome.code == ABORTED and task.hardware.behaviour.tcp_error_stands:
            raise AsError("E4025")
        return True

    return until(ends, task.hardware.now_ns)


INSTRUCTIONS = {
    "TCP_LISTEN": Action(listen, "vr"),
    "TCP_END_LISTEN": Action(end_listen, "vr"),
    "TCP_ACCEPT": Action(accept, "vrra"),
    "TCP_CONNECT": Action(connect, "vrer"),
    "TCP_SEND": Action(send, "vrerr"),
    "TCP_RECV": Action(receive, "vravrr"),
    "TCP_CLOSE": Action(close, "vr"),
}
