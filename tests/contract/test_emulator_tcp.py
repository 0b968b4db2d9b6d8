"""The TCP instructions as AS programs use them: codes, variables and times."""

from collections.abc import Callable

import pytest

from sim.controller.network import MemoryStream
from tests.fakes.as_bench import AsBench, program

PORT = 49152

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


def connected() -> tuple[AsBench, MemoryStream]:
    """Return an echo server in AS, and a client of it."""
    bench = AsBench(SERVER).start()
    assert bench.advance(1.0, lambda: PORT in bench.network.listeners)
    return bench, bench.network.dial(PORT)


def echo(bench: AsBench, client: MemoryStream, data: bytes) -> bytes:
    """Send bytes and wait for as many."""
    client.send(data)
    got = bytearray()

    def come() -> bool:
        got.extend(client.receive(65536) or b"")
        return len(got) >= len(data)

    assert bench.advance(5.0, come)
    return bytes(got)


def test_bytes_come_back_as_they_were_sent() -> None:
    """More than an element, control characters and NUL: an echo in AS loses nothing."""
    bench, client = connected()
    for data in (b"hello", bytes(range(256)), b"x" * 1000):
        assert echo(bench, client, data) == data
    assert [bench.value(f"ip[{k}]") for k in range(1, 5)] == [127, 0, 0, 1]
    assert bench.value("s") > 0


@pytest.mark.parametrize(("end", "lost"), [(MemoryStream.close, 2), (MemoryStream.reset, 1)])
def test_a_client_that_ends_is_distinguished_from_one_that_resets(
    end: Callable[[MemoryStream], object], lost: int
) -> None:
    """TCP_RECV returns 0 with n = 0, or -34025; the program ends and frees its port."""
    bench, client = connected()
    echo(bench, client, b"a")
    end(client)
    assert bench.advance(5.0, lambda: bench.task.state == "idle")
    assert bench.value("lost") == lost
    assert bench.machine.tcp.listening == ()
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


def test_listener_and_socket_survive_an_abort() -> None:
    """As on the controller: the next TCP_LISTEN fails until the port is freed."""
    bench, client = connected()
    echo(bench, client, b"a")
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
