"""Fewer wake-ups while much is received: on a real connection of this process."""

import fcntl
import select
import socket
import struct
import termios
from collections.abc import Iterator

import pytest

from common.bus import receive_batching as wakes
from common.bus.receive_batching import BUSY, MANY_B, SEARCH_STEPS, ReceiveBatching, connections

FEW = b"x" * 100


class Pair:
    """Both ends of a connection."""

    def __init__(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            self.near = socket.create_connection(server.getsockname())
            self.far, _ = server.accept()

    def send(self, data: bytes) -> None:
        """Let bytes come, and wait until the kernel has them here."""
        before = self.waiting_B
        self.far.sendall(data)
        while self.waiting_B < before + len(data):
            pass

    @property
    def waiting_B(self) -> int:
        """Bytes that have arrived and were not read."""
        found = fcntl.ioctl(self.near, termios.FIONREAD, b"\0" * 4)
        return int(struct.unpack("i", found)[0])

    def wakes(self) -> bool:
        """Whether a thread that waits for this end is woken."""
        return bool(select.select([self.near], [], [], 0.0)[0])


@pytest.fixture
def pair() -> Iterator[Pair]:
    """A connection, closed in the end."""
    pair = Pair()
    yield pair
    pair.near.close()
    pair.far.close()


def test_after_a_busy_step_a_few_bytes_wait_for_many_or_for_a_step_that_receives_little(
    pair,
) -> None:
    """Waiting bytes are taken in by the first step that receives little, and nothing is lost."""
    batching = ReceiveBatching()
    batching.step(BUSY)
    pair.send(FEW)
    assert not pair.wakes()
    pair.send(b"x" * MANY_B)
    assert pair.wakes()
    assert len(pair.near.recv(2 * MANY_B)) == MANY_B + len(FEW)
    pair.send(FEW)
    assert not pair.wakes()
    batching.step(BUSY - 1)
    assert pair.wakes()
    assert pair.near.recv(MANY_B) == FEW


def test_with_few_messages_it_is_woken_at_once(pair) -> None:
    """A request that comes alone is answered as before."""
    batching = ReceiveBatching()
    for received in (0, BUSY, 0):
        batching.step(received)
    pair.send(FEW)
    assert pair.wakes()


def test_a_connection_that_is_made_anew_is_found(pair) -> None:
    """Also in the place of one that has ended; other files are left alone."""
    batching = ReceiveBatching()
    batching.step(BUSY)
    number = pair.near.fileno()
    pair.near.close()
    batching.step(BUSY)
    assert number not in connections()
    with socket.create_server(("127.0.0.1", 0)) as server, connected_to(server) as again:
        for _ in range(SEARCH_STEPS):
            batching.step(BUSY)
        assert {again.fileno()} <= set(connections())
        assert server.fileno() not in connections()
        assert again.getsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT) == MANY_B


def test_where_the_system_has_no_list_of_open_files_nothing_is_done(monkeypatch, tmp_path) -> None:
    """It only saves work: no service is stopped by it."""
    monkeypatch.setattr(wakes, "OPEN_FILES", tmp_path / "none")
    assert connections() == []
    ReceiveBatching().step(BUSY)


def connected_to(server: socket.socket) -> socket.socket:
    """Return a connection to a server."""
    return socket.create_connection(server.getsockname())
