"""TCP unit: semantics of TCP_LISTEN, ACCEPT, CONNECT, SEND, RECV, CLOSE and END_LISTEN.

Codes are the documented ones, -(30000 + number of the E error). An operation that may take time is
a poll function: it returns None until completion, so it blocks only its own task. Listeners and
sockets belong to the controller, not to a program: they survive an abort.
"""

import math
from collections.abc import Callable, Sequence
from itertools import count
from typing import NamedTuple

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


class TcpResult(NamedTuple):
    """Result of an operation: its code (or socket), and received data."""

    code: int
    peer: Octets = NO_PEER
    elements: tuple[str, ...] = ()


class TcpStatus(NamedTuple):
    """Row of TCP_STATUS: a listener or a socket."""

    port: int
    socket: int
    code: int = OK  # of the last error
    peer: Octets = NO_PEER


Operation = Callable[[int], TcpResult | None]
"""Poll function of an operation at a time [ns]: the outcome, or None while in progress."""


def poll(attempt: Callable[[], TcpResult | None], end_ns: float) -> Operation:
    """Return an operation that repeats an attempt until it has a result, or time is up."""

    def attempted(now_ns: int) -> TcpResult | None:
        try:
            result = attempt()
        except OSError:
            return TcpResult(ABORTED)
        return TcpResult(TIMED_OUT) if result is None and now_ns >= end_ns else result

    return attempted


class TcpUnit:
    """Listeners and sockets of the controller."""

    def __init__(self, network: Network, *, send_ignores_timeout: bool = False) -> None:
        """Start without open ports and sockets."""
        self._network = network
        self._endless_send = send_ignores_timeout
        self._listeners: dict[int, Listener] = {}
        self._streams: dict[int, ByteStream] = {}
        self._ports: dict[int, int] = {}  # of each socket: that of its listener, or of its peer
        self._codes: dict[int, int] = {}  # of each socket: its last error
        self._numbers = count(1)

    @property
    def listening(self) -> tuple[int, ...]:
        """Open ports."""
        return tuple(self._listeners)

    @property
    def sockets(self) -> tuple[int, ...]:
        """Socket numbers in use."""
        return tuple(self._streams)

    def status(self) -> list[TcpStatus]:
        """Return the listeners, with socket 0, and the sockets."""
        listeners = [TcpStatus(port, 0) for port in self._listeners]
        return listeners + [
            TcpStatus(self._ports[number], number, self._codes.get(number, OK), stream.peer)
            for number, stream in self._streams.items()
        ]

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
        self._ports.pop(number)
        self._codes.pop(number, None)
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

        def attempt() -> TcpResult | None:
            listener = self._listeners.get(port)
            if listener is None:
                return TcpResult(NOT_LISTENING)
            stream = listener.accept()
            return None if stream is None else TcpResult(self._add(stream, port), stream.peer)

        return poll(attempt, end_ns)

    def connect(self, peer: Octets, port: int, end_ns: int) -> Operation:
        """Connect to a server: the code is the socket's number, or negative."""
        try:
            stream = self._network.connect(peer, port)
        except OSError:
            return lambda _: TcpResult(CANNOT_REACH)

        def established(now_ns: int) -> TcpResult | None:
            try:
                if stream.ready():
                    return TcpResult(self._add(stream, port), peer)
            except OSError:
                stream.close()
                return TcpResult(CANNOT_REACH)
            if now_ns < end_ns:
                return None
            stream.close()
            return TcpResult(TIMED_OUT)

        return established

    def send(self, number: int, elements: Sequence[str], end_ns: int) -> Operation:
        """Send strings without separators; at most 4096 bytes."""
        rest = "".join(elements).encode("latin-1")
        if len(rest) > BYTES_PER_CALL:
            return lambda _: TcpResult(TOO_LONG)

        def attempt() -> TcpResult | None:
            nonlocal rest
            stream = self._streams.get(number)
            if stream is None:
                return TcpResult(BAD_SOCKET)
            try:
                rest = rest[stream.send(rest) :] if rest else rest
            except OSError:
                self._codes[number] = ABORTED
                raise
            return None if rest else TcpResult(OK)

        return poll(attempt, math.inf if self._endless_send else end_ns)

    def receive(self, number: int, end_ns: int, *, longest: int) -> Operation:
        """Wait for bytes, cut into elements of at most `longest` characters.

        After the peer has closed, the code is 0 and there is no element.
        """

        def attempt() -> TcpResult | None:
            stream = self._streams.get(number)
            if stream is None:
                return TcpResult(BAD_SOCKET)
            try:
                data = stream.receive(BYTES_PER_CALL)
            except OSError:
                self._codes[number] = ABORTED
                raise
            if data is None:
                return None
            text = data.decode("latin-1")
            cuts = range(0, len(text), longest)
            return TcpResult(OK, elements=tuple(text[at : at + longest] for at in cuts))

        return poll(attempt, end_ns)

    def _add(self, stream: ByteStream, port: int) -> int:
        number = next(self._numbers)
        self._streams[number], self._ports[number] = stream, port
        return number
