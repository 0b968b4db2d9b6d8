"""The TCP instructions as AS programs use them: on real loopback sockets and on wires in memory."""

import socket
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from sim.controller.behaviour import Behaviour, pessimistic
from sim.controller.network import SocketNetwork
from tests.fakes.as_bench import FAST, AsBench, program

pytestmark = pytest.mark.realtime

PORT = 49152
REAL_DEADLINE_S = 20.0

SERVER = program(
    "TCP_LISTEN r, 49152",
    "s = 0",
    "WHILE s < 1 DO",
    "TCP_ACCEPT s, 49152, 1, ip[1]",
    "END",
    "lost = 0",
    "WHILE NOT lost DO",
    "n = 0",
    "TCP_RECV r, s, $in[1], n, 1, 100",
    "IF (r < 0) AND (r <> -34024) THEN",
    "lost = 1",
    "END",
    "IF (r == 0) AND (n < 1) THEN",
    "lost = 2",
    "END",
    "IF n > 0 THEN",
    "TCP_SEND q, s, $in[1], n",
    "END",
    "END",
    "TCP_CLOSE r, s",
    "TCP_END_LISTEN r, 49152",
)


class Caller:
    """A client of the controller: bytes in, bytes out, on a socket or in memory."""

    def __init__(self, bench: AsBench, sockets: SocketNetwork | None) -> None:
        self._bench, self._sockets = bench, sockets
        self.end: Any = None

    def call(self) -> None:
        """Wait until the port is open, and connect."""
        port = self._sockets.bound if self._sockets else self._bench.network.listeners
        self.advance_until(lambda: PORT in port)
        if self._sockets is None:
            self.end = self._bench.network.dial(PORT)
        else:
            self.end = socket.create_connection(("127.0.0.1", self._sockets.bound[PORT]))
            self.end.setblocking(False)

    def echo(self, data: bytes) -> bytes:
        """Send bytes and wait for as many."""
        self.end.send(data)
        got = b""

        def come() -> bool:
            nonlocal got
            got += self._receive()
            return len(got) >= len(data)

        self.advance_until(come)
        return got

    def reset(self) -> None:
        """Cut the connection."""
        if self._sockets is None:
            self.end.reset()
        else:
            self.end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self.end.close()

    def advance_until(self, condition: Callable[[], object]) -> None:
        """Advance the controller until a condition is true."""
        deadline = time.monotonic() + REAL_DEADLINE_S
        while not self._bench.advance(0.01, condition):
            assert time.monotonic() < deadline, "the controller does not do it"

    def _receive(self) -> bytes:
        try:
            return (
                self.end.receive(65536) if self._sockets is None else self.end.recv(65536)
            ) or b""
        except BlockingIOError:
            return b""


def bench_on(kind: str, source: str, behaviour: Behaviour = FAST) -> tuple[AsBench, Caller]:
    """Make a controller on real sockets or on wires in memory."""
    bench = AsBench(source, behaviour)
    sockets = None
    if kind == "sockets":
        sockets = SocketNetwork(port=0)
        bench.machine.tcp._network = sockets
    return bench, Caller(bench, sockets)


@pytest.fixture(params=["sockets", "memory"])
def server(request: pytest.FixtureRequest) -> Iterator[tuple[AsBench, Caller]]:
    """Start an echo server in AS; return it and its client."""
    bench, caller = bench_on(request.param, SERVER)
    bench.start()
    yield bench, caller
    bench.machine.tcp.close_all()
    if caller.end is not None:
        caller.end.close()


def test_bytes_come_back_as_they_were_sent(server: tuple[AsBench, Caller]) -> None:
    """More than an element, control characters and NUL: an echo in AS loses nothing."""
    bench, caller = server
    caller.call()
    for data in (b"hello", bytes(range(256)), b"x" * 1000):
        assert caller.echo(data) == data
    assert [bench.value(f"ip[{k}]") for k in range(1, 5)] == [127, 0, 0, 1]
    assert bench.value("s") > 0


def test_a_client_that_closes_gives_no_element_and_no_error(
    server: tuple[AsBench, Caller],
) -> None:
    """TCP_RECV returns 0 with n = 0; the program ends and frees its port."""
    bench, caller = server
    caller.call()
    caller.echo(b"a")
    caller.end.close()
    caller.advance_until(lambda: bench.task.state == "idle")
    assert bench.value("lost") == 2
    assert bench.machine.tcp.listening == ()
    assert not bench.machine.stops


def test_a_client_that_resets_is_a_lost_connection(server: tuple[AsBench, Caller]) -> None:
    """TCP_RECV returns -34025, and the program goes on."""
    bench, caller = server
    caller.call()
    caller.echo(b"a")
    caller.reset()
    caller.advance_until(lambda: bench.task.state == "idle")
    assert bench.value("lost") == 1
    assert not bench.machine.stops


def test_a_time_out_is_34024_after_its_time_and_other_programs_go_on() -> None:
    """Only the task that waits is blocked: the robot program continues to count."""
    source = program("TCP_LISTEN r, 49152", "t1 = TIMER(0)", "TCP_ACCEPT a, 49152, 2",
                     "t2 = TIMER(0)", name="listen") + program(
                     "n = 0", "PCEXECUTE 1: listen", "WHILE TASK(1001) DO", "n = n+1", "TWAIT 0.01",
                     "END")  # fmt: skip
    bench = AsBench(source).run()
    assert bench.value("a") == -34024
    assert bench.value("t2") - bench.value("t1") == pytest.approx(2.0, abs=0.01)
    assert bench.value("n") == pytest.approx(190, abs=12)


@pytest.mark.parametrize(
    ("behaviour", "timeout_s", "lasts_s"),
    [
        (FAST, 0.2, 0.2),
        (FAST, 1.2, 1.2),
        (pessimistic(2e-5), 0.2, 1.0),
        (pessimistic(2e-5), 1.2, 2.0),
    ],
)
def test_a_fraction_of_a_second_in_a_time_out_is_an_open_question(
    behaviour: Behaviour, timeout_s: float, lasts_s: float
) -> None:
    """Honoured by default, rounded up to a whole second by the pessimistic controller."""
    source = program("TCP_LISTEN r, 49152", "t1 = TIMER(0)", f"TCP_ACCEPT a, 49152, {timeout_s}",
                     "t = TIMER(0)-t1")  # fmt: skip
    assert AsBench(source, behaviour).run().value("t") == pytest.approx(lasts_s, abs=0.02)


def test_listener_and_socket_survive_an_abort() -> None:
    """As on the controller: the next TCP_LISTEN fails until the port is freed."""
    bench, caller = bench_on("memory", SERVER)
    bench.start()
    caller.call()
    caller.echo(b"a")
    bench.pendant.abort()
    bench.advance(0.1)
    assert bench.machine.tcp.listening == (PORT,)
    assert len(bench.machine.tcp.sockets) == 1
    bench.start().advance(0.1)
    assert bench.value("r") == -34055


def test_wrong_numbers_give_the_documented_codes() -> None:
    """No listener, no such socket, no server to connect to, too many bytes."""
    source = program("TCP_ACCEPT a, 49152, 1", "TCP_CLOSE b, 7", "TCP_END_LISTEN c, 49152",
                     "n = 0", "TCP_RECV d, 7, $x[0], n, 1", '$y[0] = "q"',
                     "TCP_SEND e, 7, $y[0], 1",
                     "ip[0] = 127", "ip[1] = 0", "ip[2] = 0", "ip[3] = 1",
                     "TCP_CONNECT f, 49153, ip[0], 1", "FOR k = 0 TO 16", "$z[k] = $SPACE(255)",
                     "END", "TCP_SEND g, 7, $z[0], 17")  # fmt: skip
    bench = AsBench(source).run()
    codes = [bench.value(name) for name in "abcdefg"]
    assert codes == [-34056, -34057, -34056, -34057, -34057, -34023, -34022]


def test_sending_an_undefined_element_is_e0104() -> None:
    """Elements behind the last one that is defined cannot be sent."""
    source = program('$y[0] = "q"', "TCP_SEND e, 1, $y[0], 2")
    assert AsBench(source).fail().code == "E0104"


def test_a_program_connects_to_a_server_of_ours() -> None:
    """TCP_CONNECT, TCP_SEND and TCP_RECV as a client on a real socket."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        source = program("ip[1] = 127", "ip[2] = 0", "ip[3] = 0", "ip[4] = 1",
                         f"TCP_CONNECT s, {port}, ip[1], 5", '$a[1] = "ask"',
                         "TCP_SEND r, s, $a[1], 1", "n = 0",
                         "TCP_RECV r, s, $b[1], n, 5", "TCP_CLOSE r, s")  # fmt: skip
        bench, caller = bench_on("sockets", source)
        bench.start()
        listening.settimeout(REAL_DEADLINE_S)
        caller.advance_until(lambda: bench.value("r") is not None)
        peer, _ = listening.accept()
        with peer:
            peer.settimeout(REAL_DEADLINE_S)
            assert peer.recv(100) == b"ask"
            peer.sendall(b"sent")
            caller.advance_until(lambda: bench.task.state == "idle")
    assert bench.value("$b[1]") == "sent"
    assert not bench.machine.stops
