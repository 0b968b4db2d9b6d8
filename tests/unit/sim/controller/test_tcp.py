"""TCP below the instructions: codes, time-outs, cuts; on sockets and on wires in memory alike."""

import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest

from forcemesh.clock import NS_PER_S
from sim.controller.network import LOOPBACK, MemoryNetwork, SocketNetwork
from sim.controller.tcp import (
    ABORTED,
    NOT_LISTENING,
    OK,
    TIMED_OUT,
    TOO_LONG,
    TcpResult,
    TcpUnit,
)

PORT = 49152
PATIENCE = 2_000_000  # polls, each of which costs far more than a microsecond


class SocketPeer:
    """A client on a real socket, with the methods of a wire in memory."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=5.0)
        self._socket.setblocking(False)

    def send(self, data: bytes) -> object:
        """Send bytes."""
        return self._socket.send(data)

    def receive(self, most: int) -> bytes | None:
        """Return the bytes that have arrived."""
        with suppress(BlockingIOError):
            return self._socket.recv(most)
        return None

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def reset(self) -> None:
        """Cut the connection."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        self._socket.close()


class TcpBench:
    """A controller's TCP unit and a client that can call it."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.network = SocketNetwork(port=0) if kind == "sockets" else MemoryNetwork()
        self.tcp = TcpUnit(self.network)
        self.peers: list[Any] = []

    def call(self) -> Any:
        """Connect to the controller."""
        if isinstance(self.network, SocketNetwork):
            self.peers.append(SocketPeer(self.network.bound[PORT]))
        else:
            self.peers.append(self.network.dial(PORT))
        return self.peers[-1]

    def end(self) -> None:
        """Close everything."""
        self.tcp.close_all()
        for peer in self.peers:
            peer.close()

    def accepted(self) -> tuple[int, Any]:
        """A socket of the controller and its peer."""
        self.tcp.listen(PORT)
        peer = self.call()
        outcome = until(self.tcp.accept(PORT, end_ns=NS_PER_S))
        assert outcome.code > 0
        assert outcome.peer == LOOPBACK
        return outcome.code, peer

    def received(self, number: int, longest: int = 255, now_ns: int = 0) -> TcpResult:
        """TCP_RECV, polled until it is over."""
        operation = self.tcp.receive(number, end_ns=NS_PER_S, longest=longest)
        return until(operation, now_ns)


def until(operation: Callable[[int], TcpResult | None], now_ns: int = 0) -> TcpResult:
    """Poll an operation at one instant until it is over."""
    for _ in range(PATIENCE):
        outcome = operation(now_ns)
        if outcome is not None:
            return outcome
    pytest.fail("the operation does not end")


@pytest.fixture(params=["sockets", "memory"])
def world(request: pytest.FixtureRequest) -> Iterator[TcpBench]:
    """Return a world that is cleaned up."""
    world = TcpBench(request.param)
    yield world
    world.end()


def test_a_port_that_is_freed_while_a_program_waits_is_34056(world: TcpBench) -> None:
    """It waits no longer."""
    world.tcp.listen(PORT)
    operation = world.tcp.accept(PORT, end_ns=NS_PER_S)
    assert operation(0) is None
    world.tcp.end_listen(PORT)
    assert operation(0) == TcpResult(NOT_LISTENING)


def test_bytes_come_as_elements_of_the_length_asked_for(world: TcpBench) -> None:
    """300 bytes are 255 + 45 by default, and 100 + 100 + 100 when asked for."""
    number, peer = world.accepted()
    peer.send(b"x" * 300)
    assert [len(e) for e in world.received(number).elements] == [255, 45]
    peer.send(b"y" * 300)
    assert [len(e) for e in world.received(number, 100).elements] == [100, 100, 100]


def test_one_call_takes_4096_bytes_at_most_and_the_next_one_the_rest(world: TcpBench) -> None:
    """No byte is lost at the limit of a call, whatever the division of the bytes is."""
    number, peer = world.accepted()
    data = bytes(range(256)) * 20
    peer.send(data)
    got: list[str] = []
    while sum(map(len, got)) < len(data):
        outcome = world.received(number)
        assert sum(map(len, outcome.elements)) <= 4096
        got += outcome.elements
    assert "".join(got).encode("latin-1") == data


def test_more_than_4096_bytes_in_one_call_are_34022_and_nothing_is_sent(world: TcpBench) -> None:
    """17 elements of 255 characters are too many, 16 are not."""
    number, peer = world.accepted()
    element = "z" * 255
    assert until(world.tcp.send(number, [element] * 17, end_ns=NS_PER_S)).code == TOO_LONG
    assert peer.receive(65536) is None
    assert until(world.tcp.send(number, [element] * 16, end_ns=NS_PER_S)).code == OK


@pytest.mark.parametrize("patient", [False, True])
def test_a_peer_that_reads_nothing_stops_the_sender(world: TcpBench, patient: bool) -> None:
    """Full buffers: -34024 at the time-out; the pessimistic controller waits on."""
    number, _ = world.accepted()
    world.tcp._endless_send = patient
    for _ in range(100_000):
        operation = world.tcp.send(number, ["q" * 255] * 16, end_ns=NS_PER_S)
        if operation(0) is None:
            break
    else:
        pytest.fail("the buffers never filled")
    expected = None if patient else TcpResult(TIMED_OUT)
    assert operation(NS_PER_S) == expected


def test_silence_is_34024_and_a_closed_peer_is_code_0_without_elements(world: TcpBench) -> None:
    """The two are distinguished, as AS programs do."""
    number, peer = world.accepted()
    assert world.received(number, now_ns=NS_PER_S) == TcpResult(TIMED_OUT)
    peer.send(b"last")
    peer.close()
    assert world.received(number).elements == ("last",)
    assert world.received(number) == TcpResult(OK)


def test_a_reset_is_34025_for_receiving_and_sending(world: TcpBench) -> None:
    """The peer cut the connection: -34025."""
    number, peer = world.accepted()
    peer.reset()
    codes = {world.received(number).code for _ in range(2)}
    assert ABORTED in codes
    sent = [until(world.tcp.send(number, ["a"], end_ns=NS_PER_S)).code for _ in range(3)]
    assert ABORTED in sent
