"""TCP of the emulated controller on real sockets; in memory: contract/test_emulator_tcp.py."""

import socket
from collections.abc import Callable, Iterator

import pytest

from forcemesh.clock import NS_PER_S
from sim.controller.network import LOOPBACK, SocketNetwork
from sim.controller.tcp import ABORTED, OK, TIMED_OUT, TOO_LONG, TcpResult, TcpUnit

PORT = 49152
PATIENCE = 2_000_000  # polls, each of which costs far more than a microsecond
RESET = b"\1\0\0\0\0\0\0\0"  # SO_LINGER: cut the connection when it is closed


def until(operation: Callable[[int], TcpResult | None], now_ns: int = 0) -> TcpResult:
    """Poll an operation at one instant until it is over."""
    for _ in range(PATIENCE):
        outcome = operation(now_ns)
        if outcome is not None:
            return outcome
    pytest.fail("the operation does not end")


class Connection:
    """A socket of the controller and its peer."""

    def __init__(self) -> None:
        network = SocketNetwork(port=0)
        self.tcp = TcpUnit(network)
        assert self.tcp.listen(PORT) == OK
        self.peer = socket.create_connection(("127.0.0.1", network.bound[PORT]), timeout=5.0)
        accepted = until(self.tcp.accept(PORT, end_ns=NS_PER_S))
        assert accepted.peer == LOOPBACK
        self.number = accepted.code

    def receive(self, now_ns: int = 0) -> TcpResult:
        """TCP_RECV, polled until it is over."""
        return until(self.tcp.receive(self.number, end_ns=NS_PER_S, longest=255), now_ns)


@pytest.fixture
def connection() -> Iterator[Connection]:
    """Return a connection that is closed at the end."""
    made = Connection()
    yield made
    made.tcp.close_all()
    made.peer.close()


def test_one_call_takes_4096_bytes_at_most_and_the_next_one_the_rest(
    connection: Connection,
) -> None:
    """No byte is lost at the limit of a call, whatever the division of the bytes is."""
    data = bytes(range(256)) * 20
    connection.peer.sendall(data)
    got: list[str] = []
    while sum(map(len, got)) < len(data):
        outcome = connection.receive()
        assert sum(map(len, outcome.elements)) <= 4096
        got += outcome.elements
    assert "".join(got).encode("latin-1") == data


@pytest.mark.parametrize("patient", [False, True])
def test_a_peer_that_reads_nothing_stops_the_sender(connection: Connection, patient: bool) -> None:
    """Full buffers: -34024 at the time-out; the pessimistic controller waits on."""
    tcp, element = connection.tcp, "q" * 255
    assert until(tcp.send(connection.number, [element] * 17, end_ns=NS_PER_S)).code == TOO_LONG
    tcp._endless_send = patient
    for _ in range(100_000):
        operation = tcp.send(connection.number, [element] * 16, end_ns=NS_PER_S)
        if operation(0) is None:
            break
    else:
        pytest.fail("the buffers never filled")
    assert operation(NS_PER_S) == (None if patient else TcpResult(TIMED_OUT))


def test_silence_a_closed_and_a_reset_peer_are_distinguished(connection: Connection) -> None:
    """-34024, code 0 without elements, -34025 for receiving and sending."""
    assert connection.receive(now_ns=NS_PER_S) == TcpResult(TIMED_OUT)
    connection.peer.sendall(b"last")
    connection.peer.close()
    assert connection.receive().elements == ("last",)
    assert connection.receive() == TcpResult(OK)
    other = Connection()
    other.peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
    other.peer.close()
    assert ABORTED in {other.receive().code for _ in range(2)}
    tried = range(3)
    sent = {until(other.tcp.send(other.number, ["a"], end_ns=NS_PER_S)).code for _ in tried}
    assert ABORTED in sent
    other.tcp.close_all()
