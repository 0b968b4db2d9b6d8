"""TCP instructions: argument order, ranges, and result variables."""

from collections.abc import Callable

from sim.as_language.syntax import Instruction
from sim.controller.compiled import Op
from sim.controller.evaluate import ArgumentCompiler
from sim.controller.network import Octets
from sim.controller.speeds import checked
from sim.controller.task import Task
from sim.controller.tcp import (
    DEFAULT_TIMEOUT_S,
    ELEMENT_CHARS,
    PORTS,
    Operation,
    TcpResult,
)

_MOST_ELEMENTS = 4096
_LONGEST_TIMEOUT_S = 3600.0


def compile_listen(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile TCP_LISTEN ret,port and TCP_END_LISTEN ret,port."""
    store = evaluate.result(statement, 0)
    port = evaluate.argument(statement, 1)
    opens = statement.name == "TCP_LISTEN"

    def run(task: Task) -> int:
        tcp, number = task.machine.tcp, port_of(port(task))
        store(task, tcp.listen(number) if opens else tcp.end_listen(number))
        return at + 1

    return run


def compile_close(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile TCP_CLOSE ret,socket."""
    store = evaluate.result(statement, 0)
    number = evaluate.argument(statement, 1)

    def run(task: Task) -> int:
        store(task, task.machine.tcp.close(int(number(task))))
        return at + 1

    return run


def compile_accept(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile TCP_ACCEPT socket,port[,timeout[,ip[k]]]."""
    store, port = evaluate.result(statement, 0), evaluate.argument(statement, 1)
    timeout_s = evaluate.argument(statement, 2, DEFAULT_TIMEOUT_S)
    store_peer = evaluate.results(statement, 3)

    def finish(task: Task, outcome: TcpResult) -> None:
        store(task, outcome.code)
        if store_peer is not None and outcome.code > 0:
            for k, octet in enumerate(outcome.peer):
                store_peer(task, k, float(octet))

    def run(task: Task) -> int:
        machine, wait_s = task.machine, timeout_of(timeout_s(task), task)
        operation = machine.tcp.accept(port_of(port(task)), timeout_s=wait_s, now_ns=machine.now_ns)
        return _wait_for(task, at, operation, now_ns=machine.now_ns, finish=finish)

    return run


def compile_connect(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile TCP_CONNECT socket,port,ip[k][,timeout]."""
    store, port = evaluate.result(statement, 0), evaluate.argument(statement, 1)
    octet, timeout_s = (
        evaluate.element(statement, 2),
        evaluate.argument(statement, 3, DEFAULT_TIMEOUT_S),
    )

    def run(task: Task) -> int:
        a, b, c, d = (int(checked(octet(task, k), 0, 255, "an octet of ip")) for k in range(4))
        peer: Octets = (a, b, c, d)
        number = int(checked(port(task), 1, 65535, "port"))
        machine, wait_s = task.machine, timeout_of(timeout_s(task), task)
        operation = machine.tcp.connect(peer, number, timeout_s=wait_s, now_ns=machine.now_ns)
        return _wait_for(task, at, operation, now_ns=machine.now_ns, finish=code_to(store))

    return run


def compile_send(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile TCP_SEND ret,socket,$a[k],n[,timeout]."""
    store, number = evaluate.result(statement, 0), evaluate.argument(statement, 1)
    element, count = evaluate.text_element(statement, 2), evaluate.argument(statement, 3)
    timeout_s = evaluate.argument(statement, 4, DEFAULT_TIMEOUT_S)

    def run(task: Task) -> int:
        n = int(checked(count(task), 1, _MOST_ELEMENTS, "the number of elements"))
        strings = [element(task, k) for k in range(n)]
        machine, wait_s = task.machine, timeout_of(timeout_s(task), task)
        operation = machine.tcp.send(
            int(number(task)), strings, timeout_s=wait_s, now_ns=machine.now_ns
        )
        return _wait_for(task, at, operation, now_ns=machine.now_ns, finish=code_to(store))

    return run


def compile_receive(statement: Instruction, at: int, evaluate: ArgumentCompiler) -> Op:
    """Compile TCP_RECV ret,socket,$a[k],n[,timeout[,maxlen]]; n receives the count."""
    store, number = evaluate.result(statement, 0), evaluate.argument(statement, 1)
    store_text = evaluate.store_at(evaluate.variable(statement, 2))
    store_count = evaluate.result(statement, 3)
    timeout_s = evaluate.argument(statement, 4, DEFAULT_TIMEOUT_S)
    longest = evaluate.argument(statement, 5, float(ELEMENT_CHARS))

    def finish(task: Task, outcome: TcpResult) -> None:
        store(task, outcome.code)
        store_count(task, len(outcome.elements))
        for k, text in enumerate(outcome.elements):
            store_text(task, k, text)

    def run(task: Task) -> int:
        chars = int(checked(longest(task), 1, ELEMENT_CHARS, "the longest element"))
        machine, wait_s = task.machine, timeout_of(timeout_s(task), task)
        operation = machine.tcp.receive(
            int(number(task)), timeout_s=wait_s, longest=chars, now_ns=machine.now_ns
        )
        return _wait_for(task, at, operation, now_ns=machine.now_ns, finish=finish)

    return run


def port_of(value: float) -> int:
    """Return a port within the controller's range. Raises AsError E0106."""
    return int(checked(value, PORTS.start, PORTS.stop - 1, "port"))


def timeout_of(value_s: float, task: Task) -> float:
    """Return the effective time-out [s]. Raises AsError E0106."""
    asked_s = checked(value_s, 0.0, _LONGEST_TIMEOUT_S, "the time-out")
    return task.machine.behaviour.timeout_s(asked_s)


def code_to(store: Callable[[Task, float], None]) -> Callable[[Task, TcpResult], None]:
    """Return a function that stores only the code of an outcome."""
    return lambda task, outcome: store(task, float(outcome.code))


def _wait_for(
    task: Task,
    at: int,
    operation: Operation,
    *,
    now_ns: int,
    finish: Callable[[Task, TcpResult], None],
) -> int:
    """Finish at once if the operation has completed, otherwise poll it every millisecond."""
    outcome = operation(now_ns)
    if outcome is not None:
        finish(task, outcome)
        return at + 1

    def condition(now_ns: int) -> bool:
        outcome = operation(now_ns)
        if outcome is None:
            return False
        finish(task, outcome)
        return True

    task.wait(condition)
    return at + 1
