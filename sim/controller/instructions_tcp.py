"""TCP instructions: argument order, ranges, and result variables."""

from collections.abc import Callable, Sequence
from typing import Any

from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.values import NUMBER, Value
from sim.controller.instruction import Action, until
from sim.controller.motion_requests import checked
from sim.controller.network import Octets
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
    store(task, task.hardware.tcp.listen(port_of(port)))


def end_listen(task: Task, store: Store, port: float) -> None:
    """TCP_END_LISTEN ret,port."""
    store(task, task.hardware.tcp.end_listen(port_of(port)))


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

    end_ns = end_of_wait_ns(task, timeout_s)
    return wait_for(task, store, task.hardware.tcp.accept(port_of(port), end_ns), finish)


def connect(
    task: Task, store: Store, port: float, peer: ReadRow, timeout_s: float = DEFAULT_TIMEOUT_S
) -> Wait | None:
    """TCP_CONNECT socket,port,ip[k][,timeout]."""
    number = int(checked(port, 1, 65535, "port"))
    octets = octets_of(peer(task, 4))
    operation = task.hardware.tcp.connect(octets, number, end_of_wait_ns(task, timeout_s))
    return wait_for(task, store, operation)


def send(
    task: Task,
    store: Store,
    number: float,
    elements: ReadRow,
    count: float,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> Wait | None:
    """TCP_SEND ret,socket,$a[k],n[,timeout]."""
    strings = strings_of(elements(task, count_of(count)), "TCP_SEND needs strings")
    operation = task.hardware.tcp.send(int(number), strings, end_of_wait_ns(task, timeout_s))
    return wait_for(task, store, operation)


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
    end_ns = end_of_wait_ns(task, timeout_s)
    operation = task.hardware.tcp.receive(int(number), end_ns, longest=chars)
    return wait_for(task, store, operation, finish)


def port_of(value: float) -> int:
    """Return a port of the controller. Raises AsError E0106."""
    return int(checked(value, PORTS.start, PORTS.stop - 1, "port"))


def count_of(value: float) -> int:
    """Return a number of elements to send. Raises AsError E0106."""
    return int(checked(value, 1, _MOST_ELEMENTS, "the number of elements"))


def octets_of(values: list[Any]) -> Octets:
    """Return an IP address. Raises AsError P0118, E0106."""
    numbers = _row(values, NUMBER, "an IP address needs numbers")
    a, b, c, d = (int(checked(number, 0, 255, "an octet of ip")) for number in numbers)
    return a, b, c, d


def strings_of(values: list[Any], reason: str) -> list[str]:
    """Return the elements to send. Raises AsError P0118."""
    return _row(values, str, reason)


def end_of_wait_ns(task: Task, timeout_s: float) -> int:
    """Return the time at which a time-out ends [ns]. Raises AsError E0106."""
    asked_s = checked(timeout_s, 0.0, _LONGEST_TIMEOUT_S, "the time-out")
    hardware = task.hardware
    return hardware.now_ns + round(hardware.behaviour.timeout_s(asked_s) * NS_PER_S)


def _row(values: list[Any], kind: type | tuple[type, ...], reason: str) -> list[Any]:
    if all(isinstance(value, kind) for value in values):
        return values
    raise AsError("P0118", reason)


def wait_for(
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
