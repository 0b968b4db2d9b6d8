"""UDP_SENDTO and UDP_RECVFROM on real sockets; in memory: tests/corpus/as/udp-and-status.as."""

import socket
import time
from collections.abc import Callable, Iterator

import pytest

from sim.controller.network import LOOPBACK, SocketNetwork
from sim.controller.tcp import CANNOT_CREATE, CANNOT_REACH, OK, TIMED_OUT, TOO_LONG, TcpResult
from sim.controller.udp import UdpUnit

PORT = 49152
PATIENCE_S = 5.0


@pytest.fixture
def client() -> Iterator[socket.socket]:
    """A socket of this host beside the controller's address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.2", 0))
        opened.settimeout(PATIENCE_S)
        yield opened


def awaited(poll: Callable[[int], TcpResult | None]) -> TcpResult:
    """Poll an operation until it has a result."""
    until_s = time.monotonic() + PATIENCE_S
    while (result := poll(0)) is None:
        assert time.monotonic() < until_s
    return result


def test_a_datagram_is_received_whole_and_cut_into_elements(client: socket.socket) -> None:
    """With its sender; the next one is not joined to it; every byte is a character."""
    network = SocketNetwork(port=0)
    udp = UdpUnit(network)
    assert udp.receive(PORT, 0, longest=255)(0) == TcpResult(TIMED_OUT)
    for data in (b"abcdefg", b"\x00\xff"):
        client.sendto(data, ("127.0.0.1", network.bound_udp[PORT]))
    sender = (127, 0, 0, 2)
    found = awaited(udp.receive(PORT, 1, longest=3))
    assert found == TcpResult(OK, sender, ("abc", "def", "g"))
    assert awaited(udp.receive(PORT, 1, longest=3)) == TcpResult(OK, sender, ("\x00\xff",))
    udp.close_all()
    assert udp.bound == ()


@pytest.mark.parametrize("binds", [True, False])
def test_strings_are_sent_as_one_datagram(client: socket.socket, binds: bool) -> None:
    """From the bound port of the same number, unless UDP_SEND_NOBIND is ON."""
    port = client.getsockname()[1]
    udp = UdpUnit(SocketNetwork("127.0.0.1"))
    udp.receive(port, 0, longest=255)
    assert udp.send((127, 0, 0, 2), port, ["ab", "\xe4"], binds=binds) == OK
    data, address = client.recvfrom(100)
    assert data == b"ab\xe4"
    assert (address[1] == port) == binds
    udp.close_all()


def test_a_port_in_use_a_bad_address_and_a_long_datagram_have_codes_of_tcp(
    client: socket.socket,
) -> None:
    """-34055, -34023 and -34022."""
    udp = UdpUnit(SocketNetwork("127.0.0.2"))
    taken = client.getsockname()[1]
    assert udp.receive(taken, 0, longest=255)(0) == TcpResult(CANNOT_CREATE)
    assert udp.bound == ()
    assert udp.send(LOOPBACK, 0, ["a"], binds=True) == CANNOT_REACH
    assert udp.send(LOOPBACK, PORT, ["x" * 255] * 17, binds=True) == TOO_LONG
