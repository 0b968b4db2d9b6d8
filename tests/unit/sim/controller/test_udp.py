"""UDP_SENDTO and UDP_RECVFROM: on sockets of this host and in memory alike."""

import socket
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from sim.controller.network import LOOPBACK, MemoryNetwork, SocketNetwork
from sim.controller.tcp import CANNOT_CREATE, CANNOT_REACH, OK, TIMED_OUT, TOO_LONG, TcpResult
from sim.controller.udp import UdpUnit
from tests.fakes.as_bench import AsBench, program

PORT = 49152
PATIENCE_S = 5.0


class Sockets:
    """Real sockets of this host."""

    def __init__(self) -> None:
        self.network = SocketNetwork(port=0)
        self._client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._client.bind(("127.0.0.1", 0))
        self._client.setblocking(False)
        self.port: int = self._client.getsockname()[1]

    def cast(self, data: bytes) -> None:
        """Send a datagram to the controller."""
        self._client.sendto(data, ("127.0.0.1", self.network.bound_udp[PORT]))

    def received(self) -> tuple[bytes, int | None] | None:
        """Return a datagram and the port it came from."""
        with suppress(BlockingIOError):
            data, address = self._client.recvfrom(65536)
            return data, address[1]
        return None

    def close(self) -> None:
        """Release the client's port."""
        self._client.close()


class Memory:
    """A network in memory."""

    def __init__(self) -> None:
        self.network = MemoryNetwork()
        self.port = 50001

    def cast(self, data: bytes) -> None:
        """Send a datagram to the controller."""
        self.network.cast(PORT, data)

    def received(self) -> tuple[bytes, int | None] | None:
        """Return a datagram; its source is not modelled."""
        return (self.network.sent.popleft()[0], None) if self.network.sent else None

    def close(self) -> None:
        """Nothing to release."""


World = Sockets | Memory


@pytest.fixture(params=[Sockets, Memory])
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    """Both networks."""
    made = request.param()
    yield made
    made.close()


@pytest.fixture
def udp(world: World) -> Iterator[UdpUnit]:
    """The controller's unit; it is switched off at the end."""
    unit = UdpUnit(world.network)
    yield unit
    unit.close_all()
    assert unit.bound == ()


def awaited(poll, end_ns: int) -> TcpResult:
    """Poll an operation until it has a result."""
    until_s = time.monotonic() + PATIENCE_S
    while (result := poll(0)) is None:
        assert time.monotonic() < until_s
    return result


def test_a_datagram_is_received_whole_and_cut_into_elements(world: World, udp: UdpUnit) -> None:
    """With its sender; the next one is not joined to it; every byte is a character."""
    assert udp.receive(PORT, 0, longest=255)(0) == TcpResult(TIMED_OUT)
    world.cast(b"abcdefg")
    world.cast(b"\x00\xff")
    assert awaited(udp.receive(PORT, 1, longest=3), 1) == TcpResult(
        OK, LOOPBACK, ("abc", "def", "g")
    )
    assert awaited(udp.receive(PORT, 1, longest=3), 1) == TcpResult(OK, LOOPBACK, ("\x00\xff",))
    assert udp.bound == (PORT,)


def test_strings_are_sent_as_one_datagram(world: World, udp: UdpUnit) -> None:
    """To the address and port that are given; more than 4096 bytes are refused."""
    assert udp.send(LOOPBACK, world.port, ["ab", "\xe4"], binds=True) == OK
    until_s = time.monotonic() + PATIENCE_S
    while (found := world.received()) is None:
        assert time.monotonic() < until_s
    assert found[0] == b"ab\xe4"
    assert udp.send(LOOPBACK, world.port, ["x" * 255] * 17, binds=True) == TOO_LONG


def test_a_port_in_use_cannot_be_bound_and_a_bad_address_not_be_reached() -> None:
    """-34055 and -34023, as with TCP."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        taken = other.getsockname()[1]
        udp = UdpUnit(SocketNetwork())
        assert udp.receive(taken, 0, longest=255)(0) == TcpResult(CANNOT_CREATE)
        assert udp.bound == ()
    network = MemoryNetwork()
    UdpUnit(network).receive(PORT, 0, longest=255)
    assert UdpUnit(network).receive(PORT, 0, longest=255)(0) == TcpResult(CANNOT_CREATE)
    assert UdpUnit(SocketNetwork()).send(LOOPBACK, 0, ["a"], binds=True) == CANNOT_REACH


@pytest.mark.parametrize("binds", [True, False])
def test_a_datagram_comes_from_the_bound_port_of_its_number(binds: bool) -> None:
    """Unless UDP_SEND_NOBIND is ON: then from any free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.bind(("127.0.0.2", 0))
        client.settimeout(PATIENCE_S)
        port = client.getsockname()[1]
        udp = UdpUnit(SocketNetwork("127.0.0.1"))
        udp.receive(port, 0, longest=255)
        assert udp.send((127, 0, 0, 2), port, ["a"], binds=binds) == OK
        _, address = client.recvfrom(100)
        udp.close_all()
    assert (address[1] == port) == binds


def test_a_datagram_for_a_port_that_is_not_bound_is_lost() -> None:
    """UDP reports nothing."""
    network = MemoryNetwork()
    network.cast(PORT, b"early")
    assert UdpUnit(network).receive(PORT, 0, longest=255)(0) == TcpResult(TIMED_OUT)


@pytest.mark.parametrize(
    ("line", "code"),
    [("UDP_RECVFROM r, 80, $s[1], n, 1, ip[1]", "E0106"),
     ("UDP_SENDTO r, ip[1], 50002, x[1], 1, 1", "P0118"),
     ("UDP_SENDTO r, big[1], 50002, $t[1], 1, 1", "E0106"),
     ("UDP_SENDTO r, ip[1], 50002, $t[1], 0, 1", "E0106")],
)  # fmt: skip
def test_arguments_are_checked(line: str, code: str) -> None:
    """Ports, addresses, strings and their number."""
    fill = ("FOR i = 1 TO 4", "ip[i] = 1", "big[i] = 256", "END", "x[1] = 1", '$t[1] = "a"')
    assert AsBench(program(*fill, line)).fail().code == code


def test_udp_send_nobind_is_read_from_the_switch(monkeypatch: pytest.MonkeyPatch) -> None:
    """ON: the program's datagram does not come from its bound port."""
    asked: list[bool] = []

    def send(*_: object, binds: bool) -> int:
        asked.append(binds)
        return OK

    for switch in ("OFF", "ON"):
        bench = AsBench(program(f"UDP_SEND_NOBIND {switch}", '$t[1] = "a"', "FOR i = 1 TO 4",
                                "ip[i] = 9", "END",
                                "UDP_SENDTO r, ip[1], 50002, $t[1], 1"))  # fmt: skip
        monkeypatch.setattr(bench.machine.hardware.udp, "send", send)
        bench.run()
    assert asked == [True, False]
