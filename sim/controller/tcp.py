"""TCP unit: semantics of TCP_LISTEN, ACCEPT, CONNECT, SEND, RECV, CLOSE and END_LISTEN.

Codes are the documented ones, -(30000 + number of the E error). An operation that may take time is
a poll function: it returns None until completion, so it blocks only its own task. Listeners and
sockets belong to the controller, not to a program: they survive an abort.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sim.controller.network import ByteStream, Listener, Network, Octets

OK = 0
TOO_LONG = -34022
CANNOT_REACH = -34023
TIMED_OUT = -34024
ABORTED = -34025
CANNOT_CREATE = -34055
NOT_LISTENING = -34056
BAD_SOCKET = -34057

BYTES_PER_CALL = 4096
ELEMENT_CHARS = 255
PORTS = range(8192, 65536)
DEFAULT_TIMEOUT_S = 1.0
NO_PEER: Octets = (0, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class TcpResult:
    """Result of an operation: its code (or socket), and received data."""

    code: int
    peer: Octets = NO_PEER
    elements: tuple[str, ...] = ()


Operation = Callable[[int], TcpResult | None]
"""Poll function of an operation at a time [ns]: the outcome, or None while in progress."""


class TcpUnit:
    """Listeners and sockets of the controller."""

    def __init__(self, network: Network, *, send_ignores_timeout: bool = False) -> None:
        """Start without open ports and sockets."""
        self._network = network
        self._endless_send = send_ignores_timeout
        self._listeners: dict[int, Listener] = {}
        self._streams: dict[int, ByteStream] = {}
        self._next = 1

    @property
    def listening(self) -> tuple[int, ...]:
        """Open ports."""
        return tuple(self._listeners)

    @property
    def sockets(self) -> tuple[int, ...]:
        """Socket numbers in use."""
        return tuple(self._streams)

    # --- immediate --------------------------------------------------------------------------------

    def listen(self, port: int) -> int:
        """Open a port; an open port cannot be opened again."""
        if port in self._listeners:
            return CANNOT_CREATE
        try:
            self._listeners[port] = self._network.listen(port)
        except OSError:
            return CANNOT_CREATE
        return OK

    def end_listen(self, port: int) -> int:
        """Release a port."""
        listener = self._listeners.pop(port, None)
        if listener is None:
            return NOT_LISTENING
        listener.close()
        return OK

    def close(self, number: int) -> int:
        """Close a socket."""
        stream = self._streams.pop(number, None)
        if stream is None:
            return BAD_SOCKET
        stream.close()
        return OK

    def close_all(self) -> None:
        """Close everything: the controller is switched off."""
        for number in self.sockets:
            self.close(number)
        for port in self.listening:
            self.end_listen(port)

    # --- with time-out ----------------------------------------------------------------------------

    def accept(self, port: int, end_ns: int) -> Operation:
        """Wait for a connection: the code is the socket's number, or negative."""

        def poll(now_ns: int) -> TcpResult | None:
            listener = self._listeners.get(port)
            if listener is None:
                return TcpResult(NOT_LISTENING)
            try:
                stream = listener.accept()
            except OSError:
                return TcpResult(ABORTED)
            if stream is not None:
                return TcpResult(self._add(stream), stream.peer)
            return TcpResult(TIMED_OUT) if now_ns >= end_ns else None

        return poll

    def connect(self, peer: Octets, port: int, end_ns: int) -> Operation:
        """Connect to a server: the code is the socket's number, or negative."""
        try:
            stream = self._network.connect(peer, port)
        except OSError:
            return lambda _: TcpResult(CANNOT_REACH)

        def poll(now_ns: int) -> TcpResult | None:
            try:
                if stream.ready():
                    return TcpResult(self._add(stream), peer)
            except OSError:
                stream.close()
                return TcpResult(CANNOT_REACH)
            if now_ns < end_ns:
                return None
            stream.close()
            return TcpResult(TIMED_OUT)

        return poll

    def send(self, number: int, elements: Sequence[str], end_ns: int) -> Operation:
        """Send strings without separators; at most 4096 bytes."""
        rest = "".join(elements).encode("latin-1")
        if len(rest) > BYTES_PER_CALL:
            return lambda _: TcpResult(TOO_LONG)

        def poll(now_ns: int) -> TcpResult | None:
            nonlocal rest
            stream = self._streams.get(number)
            if stream is None:
                return TcpResult(BAD_SOCKET)
            try:
                rest = rest[stream.send(rest) :] if rest else rest
            except OSError:
                return TcpResult(ABORTED)
            if not rest:
                return TcpResult(OK)
            late = now_ns >= end_ns and not self._endless_send
            return TcpResult(TIMED_OUT) if late else None

        return poll

    def receive(self, number: int, end_ns: int, *, longest: int) -> Operation:
        """Wait for bytes, cut into elements of at most `longest` characters.

        After the peer has closed, the code is 0 and there is no element.
        """

        def poll(now_ns: int) -> TcpResult | None:
            stream = self._streams.get(number)
            if stream is None:
                return TcpResult(BAD_SOCKET)
            try:
                data = stream.receive(BYTES_PER_CALL)
            except OSError:
                return TcpResult(ABORTED)
            if data is None:
                return TcpResult(TIMED_OUT) if now_ns >= end_ns else None
            text = data.decode("latin-1")
            cuts = range(0, len(text), longest)
            return TcpResult(OK, elements=tuple(text[at : at + longest] for at in cuts))

        return poll

    def _add(self, stream: ByteStream) -> int:
        number, self._next = self._next, self._next + 1
        self._streams[number] = stream
        return number
