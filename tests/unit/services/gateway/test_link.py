"""The gateway's socket, on real sockets: it reconnects, it watches, and it never raises."""

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
    """A listening socket that does nothing by itself."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.settimeout(PATIENCE_S)
        self.port: int = self.listener.getsockname()[1]

    def accept(self) -> socket.socket:
        """Take the connection that waits."""
        client, _ = self.listener.accept()
        client.settimeout(PATIENCE_S)
        return client


@pytest.fixture
def peer() -> Iterator[Peer]:
    """A listening socket."""
    peer = Peer()
    yield peer
    peer.listener.close()


@pytest.fixture
def deaf() -> Iterator[socket.socket]:
    """A port that is taken and does not listen."""
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))
        yield reserved


class Driver:
    """Polls a link until something is seen, as the service's loop does."""

    def __init__(self, port: int, **settings: float) -> None:
        defaults = {"pause_first_s": 0.01, "pause_longest_s": 0.05}
        self.link = Link(LinkSettings("127.0.0.1", port, **(defaults | settings)))
        self.data = b""
        self.opened = 0
        self.lost: list[str] = []

    def poll(self) -> None:
        """Poll once and keep what came."""
        news = self.link.poll(time.monotonic_ns())
        self.opened += news.opened
        self.data += news.data
        if news.lost:
            self.lost.append(news.lost)

    def until(self, seen: Callable[[], object]) -> None:
        """Poll until a condition holds."""
        give_up = time.monotonic() + PATIENCE_S
        while not seen():
            assert time.monotonic() < give_up, (self.opened, self.lost, self.link.last_fault)
            self.poll()
            time.sleep(0.0005)

    def send(self, data: bytes) -> bool:
        """Send now."""
        return self.link.send(data, time.monotonic_ns())

    def close(self) -> None:
        """End."""
        self.link.close("test over", time.monotonic_ns())


def connected(peer: Peer, **settings: float) -> tuple[Driver, socket.socket]:
    """A link that is open, and its other end."""
    driver = Driver(peer.port, **settings)
    driver.until(lambda: driver.opened)
    return driver, peer.accept()


def test_bytes_go_both_ways(peer: Peer) -> None:
    """What is sent arrives, what arrives is told once."""
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


def test_a_controller_that_is_not_there_yet_is_waited_for(deaf: socket.socket) -> None:
    """Refused connections are tried again, and nothing is raised or reported as lost."""
    driver = Driver(deaf.getsockname()[1])
    driver.until(lambda: os.strerror(errno.ECONNREFUSED) in driver.link.last_fault)
    assert not driver.send(b"x")
    deaf.listen()
    driver.until(lambda: driver.opened)
    assert driver.lost == []
    driver.close()


def test_the_pause_between_attempts_doubles_until_the_controller_greets(
    deaf: socket.socket,
) -> None:
    """0.1, 0.2, 0.4 ... up to the longest; short again after a good hello. On a virtual clock."""
    link = Link(
        LinkSettings("127.0.0.1", deaf.getsockname()[1], pause_first_s=0.1, pause_longest_s=0.4)
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
def test_a_lost_connection_is_told_once_and_made_again(reset: bool) -> None:
    """Closed or reset by the controller: a reason, then a new connection."""
    with FakeController() as controller:
        driver = Driver(controller.port)
        driver.until(lambda: driver.opened)
        assert controller.wait_for(lambda: controller.connections == 1)
        controller.drop(reset=reset)
        driver.until(lambda: driver.opened == 2)
        assert len(driver.lost) == 1
        assert str(controller.port) in driver.lost[0]
        driver.close()


def test_half_closed_is_closed(peer: Peer) -> None:
    """A controller that says no more is gone, even if it still listened."""
    driver, client = connected(peer)
    client.shutdown(socket.SHUT_WR)
    driver.until(lambda: driver.lost)
    assert "closed by the controller" in driver.lost[0]
    assert not driver.send(b"x")
    client.close()


def test_what_came_before_the_end_is_still_told(peer: Peer) -> None:
    """The last report before the connection ended is not lost."""
    driver, client = connected(peer)
    client.sendall(b"last words")
    client.close()
    driver.until(lambda: driver.lost)
    assert driver.data == b"last words"


def test_silence_ends_the_connection(peer: Peer) -> None:
    """A controller that streams endlessly and stops is frozen: connect again, and hold."""
    driver, client = connected(peer, silent_after_s=0.05)
    driver.until(lambda: driver.lost)
    assert "silent for 0.05 s" in driver.lost[0]
    client.close()


def test_packets_that_nobody_takes_end_the_connection(peer: Peer) -> None:
    """When the peer's window is shut, set points must not pile up in our kernel."""
    peer.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    driver, client = connected(peer, stalled_after_s=0.05, silent_after_s=60.0)
    packet = encode(Packet(ID_FIRST, 12, 0))

    def send_and_look() -> bool:
        driver.send(packet)
        return bool(driver.lost)

    driver.until(send_and_look)
    assert "not acknowledged for" in driver.lost[0]
    client.close()


def test_a_peer_that_reads_is_never_called_stalled(peer: Peer) -> None:
    """A steady stream that is read goes on for many times the stall limit."""
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
    """The loop goes on; the fault says which name."""
    link = Link(LinkSettings("no such host", 1))
    link.poll(0)
    assert "no such host" in link.last_fault
    assert not link.is_open
