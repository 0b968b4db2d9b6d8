"""The gateway's socket, on real sockets: it reconnects, detects silence, and never raises."""

import errno
import os
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from controller.packet import PACKET_CHARS, Packet, encode
from controller.packet_table import ID_FIRST
from forcemesh.clock import NS_PER_S
from services.gateway.link import Link, LinkSettings
from tests.fakes.controller import FakeController

pytestmark = pytest.mark.realtime

PATIENCE_S = 5.0


class Peer:
    """A passive listening socket."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.settimeout(PATIENCE_S)
        self.port: int = self.listener.getsockname()[1]

    def accept(self) -> socket.socket:
        """Accept the pending connection."""
        client, _ = self.listener.accept()
        client.settimeout(PATIENCE_S)
        return client


@pytest.fixture
def peer() -> Iterator[Peer]:
    """Yield a listening socket."""
    peer = Peer()
    yield peer
    peer.listener.close()


@pytest.fixture
def bound_port() -> Iterator[socket.socket]:
    """Yield a port that is bound and does not listen."""
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))
        yield reserved


class LinkPoller:
    """A link that is polled until a condition holds, as the service's loop does."""

    def __init__(self, port: int, **settings: float) -> None:
        defaults = {"pause_first_s": 0.01, "pause_longest_s": 0.05}
        self.link = Link(LinkSettings("127.0.0.1", port, **(defaults | settings)))
        self.data = b""
        self.opened = 0
        self.lost: list[str] = []

    def poll(self) -> None:
        """Poll once and keep the results."""
        received = self.link.poll(time.monotonic_ns())
        self.opened += received.opened
        self.data += received.data
        if received.lost:
            self.lost.append(received.lost)

    def until(self, condition: Callable[[], object]) -> None:
        """Poll until a condition holds."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline_s, (self.opened, self.lost, self.link.last_fault)
            self.poll()
            time.sleep(0.0005)

    def send(self, data: bytes) -> bool:
        """Send at the present time."""
        return self.link.send(data, time.monotonic_ns())

    def close(self) -> None:
        """Close the link."""
        self.link.close("test over", time.monotonic_ns())


def connected(peer: Peer, **settings: float) -> tuple[LinkPoller, socket.socket]:
    """Return an open link and its other end."""
    driver = LinkPoller(peer.port, **settings)
    driver.until(lambda: driver.opened)
    return driver, peer.accept()


def test_bytes_pass_in_both_directions(peer: Peer) -> None:
    """Sent bytes arrive; received bytes are reported once."""
    driver, client = connected(peer)
    assert driver.send(b"abc")
    assert client.recv(10) == b"abc"
    client.sendall(b"xyz")
    driver.until(lambda: driver.data == b"xyz")
    assert (driver.opened, driver.lost) == (1, [])
    driver.close()
    client.close()


def test_nagle_is_off(peer: Peer) -> None:
    """A set point must not wait for the acknowledgement of the one before."""
    driver, client = connected(peer)
    assert driver.link._socket is not None
    assert driver.link._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    driver.close()
    client.close()


def test_a_controller_that_does_not_listen_yet_is_tried_again(bound_port: socket.socket) -> None:
    """Refused connections are repeated; they raise nothing and do not count as lost."""
    driver = LinkPoller(bound_port.getsockname()[1])
    driver.until(lambda: os.strerror(errno.ECONNREFUSED) in driver.link.last_fault)
    assert not driver.send(b"x")
    bound_port.listen()
    driver.until(lambda: driver.opened)
    assert driver.lost == []
    driver.close()


def test_the_pause_between_attempts_doubles_until_the_controller_greets(
    bound_port: socket.socket,
) -> None:
    """0.1, 0.2, 0.4 ... up to the longest; short again after a good hello. On a virtual clock."""
    link = Link(
        LinkSettings(
            "127.0.0.1", bound_port.getsockname()[1], pause_first_s=0.1, pause_longest_s=0.4
        )
    )
    pauses_s: list[float] = []
    for now_ns in range(0, 2_000_000_000, 10_000_000):
        until_ns = link._next_attempt_ns
        link.poll(now_ns)
        if link._next_attempt_ns != until_ns:
            pauses_s.append((link._next_attempt_ns - now_ns) / NS_PER_S)
        if len(pauses_s) == 4:
            link.greeted()
    assert pauses_s[:6] == pytest.approx([0.1, 0.2, 0.4, 0.4, 0.1, 0.2])


@pytest.mark.parametrize("reset", [False, True])
def test_a_lost_connection_is_reported_once_and_made_again(reset: bool) -> None:
    """After a close or reset by the controller there is one reason, then a new connection."""
    with FakeController() as controller:
        driver = LinkPoller(controller.port)
        driver.until(lambda: driver.opened)
        assert controller.wait_for(lambda: controller.connections == 1)
        controller.drop(reset=reset)
        driver.until(lambda: driver.opened == 2)
        assert len(driver.lost) == 1
        assert str(controller.port) in driver.lost[0]
        driver.close()


def test_half_closed_is_closed(peer: Peer) -> None:
    """A controller that sends no more counts as lost, even if it still receives."""
    driver, client = connected(peer)
    client.shutdown(socket.SHUT_WR)
    driver.until(lambda: driver.lost)
    assert "closed by the controller" in driver.lost[0]
    assert not driver.send(b"x")
    client.close()


def test_data_before_the_end_is_still_reported(peer: Peer) -> None:
    """The last report before the connection ended is not lost."""
    driver, client = connected(peer)
    client.sendall(b"last data")
    client.close()
    driver.until(lambda: driver.lost)
    assert driver.data == b"last data"


def test_silence_ends_the_connection(peer: Peer) -> None:
    """A controller that streams endlessly and stops is frozen: hold and connect again."""
    driver, client = connected(peer, silent_after_s=0.05)
    driver.until(lambda: driver.lost)
    assert "silent for 0.05 s" in driver.lost[0]
    client.close()


def test_packets_that_the_peer_does_not_read_end_the_connection(peer: Peer) -> None:
    """When the peer's window is closed, set points must not accumulate in the local kernel."""
    peer.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    driver, client = connected(peer, stalled_after_s=0.05, silent_after_s=60.0)
    packet = encode(Packet(ID_FIRST, 12, 0))

    def send_until_lost() -> bool:
        driver.send(packet)
        return bool(driver.lost)

    driver.until(send_until_lost)
    assert "not acknowledged for" in driver.lost[0]
    client.close()


def test_a_peer_that_reads_is_never_reported_as_stalled(peer: Peer) -> None:
    """A steady stream that is read lasts for many times the stall limit."""
    driver, client = connected(peer, stalled_after_s=0.1, silent_after_s=60.0)
    packet = encode(Packet(ID_FIRST, 12, 0))
    started, read = time.monotonic(), 0
    while time.monotonic() - started < 0.5:
        driver.send(packet)
        read += len(client.recv(4096))
        driver.poll()
        time.sleep(0.002)
    assert driver.lost == []
    assert read >= PACKET_CHARS
    driver.close()
    client.close()


def test_a_name_that_does_not_resolve_is_a_fault_and_not_an_exception() -> None:
    """The loop continues; the fault has the name."""
    link = Link(LinkSettings("no such host", 1))
    link.poll(0)
    assert "no such host" in link.last_fault
    assert not link.is_open
