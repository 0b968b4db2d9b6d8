"""Transport of the TCP instructions: real sockets, or in-memory streams for lock step.

All calls are non-blocking. A broken connection raises OSError; other results are values. Sockets
and in-memory streams have the same methods.
"""

import socket
import struct
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, TypeVar

from forcemesh.clock import NS_PER_S

Events = TypeVar("Events")
Octets = tuple[int, int, int, int]
LOOPBACK: Octets = (127, 0, 0, 1)
WIRE_BYTES = 16_384  # buffer of an in-memory stream before its writer has to wait
PAUSE_S = 0.1  # between attempts of a client in lock step to connect
RECEIVE_BYTES = 16_384

# --- sockets --------------------------------------------------------------------------------------


class SocketStream:
    """A TCP connection of this host."""

    def __init__(self, connection: socket.socket, peer: Octets, *, pending: bool = False) -> None:
        """Take over a socket."""
        connection.setblocking(False)  # noqa: FBT003 - the library's own signature
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.peer = peer
        self._socket, self._pending = connection, pending

    def ready(self) -> bool:
        """Return whether the connection is established. Raises OSError if it fails."""
        if self._pending:
            number = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if number:
                raise OSError(number, "connection failed")
            try:
                self._socket.getpeername()
            except OSError:
                return False
            self._pending = False
        return True

    def receive(self, most: int) -> bytes | None:
        """Return received bytes; None if there are none, b"" at the end of the stream."""
        try:
            return self._socket.recv(most)
        except BlockingIOError:
            return None

    def send(self, data: bytes) -> int:
        """Send as much as the buffer accepts; return the number of bytes. Raises OSError."""
        try:
            return self._socket.send(data, socket.MSG_NOSIGNAL)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close the connection."""
        with suppress(OSError):
            self._socket.close()

    def reset(self) -> None:
        """Abort the connection with a TCP reset."""
        with suppress(OSError):
            now = struct.pack("ii", 1, 0)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, now)
        self.close()


class SocketListener:
    """A listening port of this host."""

    def __init__(self, listening: socket.socket) -> None:
        """Take over a listening socket."""
        listening.setblocking(False)  # noqa: FBT003 - the library's own signature
        self._socket = listening

    @property
    def port(self) -> int:
        """The port number."""
        port: int = self._socket.getsockname()[1]
        return port

    def accept(self) -> SocketStream | None:
        """Return a new connection, or None."""
        try:
            connection, address = self._socket.accept()
        except BlockingIOError:
            return None
        a, b, c, d = (int(octet) for octet in address[0].split("."))
        return SocketStream(connection, (a, b, c, d))

    def close(self) -> None:
        """Release the port."""
        with suppress(OSError):
            self._socket.close()


class SocketDatagrams:
    """A UDP port of this host."""

    def __init__(self, bound: socket.socket) -> None:
        """Take over a bound socket."""
        bound.setblocking(False)  # noqa: FBT003 - the library's own signature
        self._socket = bound

    @property
    def port(self) -> int:
        """The port number."""
        port: int = self._socket.getsockname()[1]
        return port

    def send(self, data: bytes, peer: Octets, port: int) -> None:
        """Send a datagram. Raises OSError."""
        self._socket.sendto(data, (".".join(map(str, peer)), port))

    def receive(self, most: int) -> tuple[bytes, Octets] | None:
        """Return a datagram and its sender, or None."""
        try:
            data, address = self._socket.recvfrom(most)
        except BlockingIOError:
            return None
        a, b, c, d = (int(octet) for octet in address[0].split("."))
        return data, (a, b, c, d)

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


class SocketNetwork:
    """Sockets of this host. `port` replaces every port that a program opens."""

    def __init__(self, address: str = "127.0.0.1", port: int | None = None) -> None:
        """Listen on one address only, "" for all of this host; port 0: any free port."""
        self._address, self._port = address, port
        self.bound: dict[int, int] = {}  # the program's port -> the real one
        self.bound_udp: dict[int, int] = {}

    def listen(self, port: int) -> SocketListener:
        """Open a port. Raises OSError if it is in use."""
        real = port if self._port is None else self._port
        listener = SocketListener(socket.create_server((self._address, real), backlog=5))
        self.bound[port] = listener.port
        return listener

    def datagrams(self, port: int) -> SocketDatagrams:
        """Bind a UDP port; 0 is any free one, of all addresses. Raises OSError if it is in use."""
        bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        real = port if self._port is None else self._port
        try:
            bound.bind((self._address, real) if port else ("", 0))
        except OSError:
            bound.close()
            raise
        datagrams = SocketDatagrams(bound)
        if port:
            self.bound_udp[port] = datagrams.port
        return datagrams

    def connect(self, peer: Octets, port: int) -> SocketStream:
        """Start a connection; it is established later (`ready`). Raises OSError."""
        connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        stream = SocketStream(connection, peer, pending=True)
        with suppress(BlockingIOError):
            connection.connect((".".join(str(octet) for octet in peer), port))
        return stream


# --- in-memory streams ----------------------------------------------------------------------------


class MemoryStream:
    """One end of an in-memory stream; `partner` is the other one."""

    def __init__(self, peer: Octets = LOOPBACK) -> None:
        """Create an unconnected end; `MemoryNetwork.dial` joins two."""
        self.peer = peer
        self.partner: MemoryStream | None = None
        self.closed = False
        self.cut = False  # a reset instead of an end
        self._inbox: deque[bytes] = deque()
        self._held = 0

    def ready(self) -> bool:
        """Return True: in-memory streams are established at once."""
        return True

    def receive(self, most: int) -> bytes | None:
        """Return received bytes; None if there are none, b"" at the end of the stream."""
        if self.cut or self.closed:
            raise ConnectionResetError("the connection was reset")
        if not self._inbox:
            return b"" if self.partner is None or self.partner.closed else None
        data = b"".join(self._inbox)
        self._inbox.clear()
        head, rest = data[:most], data[most:]
        if rest:
            self._inbox.append(rest)
        self._held = len(rest)
        return head

    def send(self, data: bytes) -> int:
        """Send as much as the buffer accepts; return the number of bytes. Raises OSError."""
        other = self.partner
        if self.cut or self.closed or other is None or other.closed:
            raise ConnectionResetError("the connection was reset")
        count = min(len(data), WIRE_BYTES - other._held)  # noqa: SLF001 - its own kind
        if count > 0:
            other._inbox.append(data[:count])  # noqa: SLF001
            other._held += count  # noqa: SLF001
        return max(0, count)

    def close(self) -> None:
        """Close both directions; data already sent can still be read."""
        self.closed = True

    def reset(self) -> None:
        """Abort the stream: the other end gets an error and discards unread data."""
        self.closed = True
        if self.partner is not None:
            self.partner.cut = True


class MemoryListener:
    """A port of a MemoryNetwork."""

    def __init__(self, network: "MemoryNetwork", port: int) -> None:
        """Open the port."""
        self._network, self._port = network, port
        self.waiting: deque[MemoryStream] = deque()

    def accept(self) -> MemoryStream | None:
        """Return a new connection, or None."""
        return self.waiting.popleft() if self.waiting else None

    def close(self) -> None:
        """Release the port; connections not yet accepted are reset."""
        for stream in self.waiting:
            stream.reset()
        self._network.listeners.pop(self._port, None)


class MemoryDatagrams:
    """A UDP port of a MemoryNetwork."""

    def __init__(self, network: "MemoryNetwork", port: int) -> None:
        """Bind the port."""
        self._network, self.port = network, port
        self.inbox: deque[tuple[bytes, Octets]] = deque()

    def send(self, data: bytes, peer: Octets, port: int) -> None:
        """Send a datagram: to a port of the controller itself, or to the client."""
        if peer == LOOPBACK and port in self._network.bound_udp:
            self._network.cast(port, data)
        else:
            self._network.sent.append((data, peer, port))

    def receive(self, most: int) -> tuple[bytes, Octets] | None:
        """Return a datagram and its sender, or None; what is longer than `most` is cut."""
        if not self.inbox:
            return None
        data, peer = self.inbox.popleft()
        return data[:most], peer

    def close(self) -> None:
        """Release the port."""
        self._network.bound_udp.pop(self.port, None)


class MemoryNetwork:
    """In-memory network: both ends in one process, for a controller in lock step with a client."""

    def __init__(self) -> None:
        """Start without open ports."""
        self.listeners: dict[int, MemoryListener] = {}
        self.bound_udp: dict[int, MemoryDatagrams] = {}
        self.sent: deque[tuple[bytes, Octets, int]] = deque()  # datagrams for a client

    def listen(self, port: int) -> MemoryListener:
        """Open a port. Raises OSError if it is in use."""
        if port in self.listeners:
            raise OSError(f"port {port} is in use")
        self.listeners[port] = MemoryListener(self, port)
        return self.listeners[port]

    def datagrams(self, port: int) -> MemoryDatagrams:
        """Bind a UDP port; 0 is one that receives nothing. Raises OSError if it is in use."""
        if port in self.bound_udp:
            raise OSError(f"UDP port {port} is in use")
        near = MemoryDatagrams(self, port)
        if port:
            self.bound_udp[port] = near
        return near

    def cast(self, port: int, data: bytes, peer: Octets = LOOPBACK) -> None:
        """Send a datagram to the controller, as a client; without a bound port it is lost."""
        if port in self.bound_udp:
            self.bound_udp[port].inbox.append((data, peer))

    def connect(self, peer: Octets, port: int) -> MemoryStream:
        """Connect to a port of this network. Raises OSError if it is not open."""
        stream = self.dial(port)
        stream.peer = peer
        return stream

    def dial(self, port: int, peer: Octets = LOOPBACK) -> MemoryStream:
        """Connect to a port of the controller, as a client. Raises OSError if it is not open.

        `peer` is the client address reported to the controller.
        """
        listener = self.listeners.get(port)
        if listener is None:
            raise ConnectionRefusedError(f"port {port} is not open")
        near, far = MemoryStream(), MemoryStream(peer)
        near.partner, far.partner = far, near
        listener.waiting.append(far)
        return near


class LockStepLink(Generic[Events]):
    """In-memory link with the interface of a socket link, for a client in lock step.

    Connects to a port of a MemoryNetwork and reconnects after a loss. `poll` reports events as a
    socket link does: opened, bytes, lost. Timing depends only on the virtual clock, so a run is
    repeatable to the byte.
    """

    def __init__(
        self, network: MemoryNetwork, port: int, make_events: Callable[[bool, bytes, str], Events]
    ) -> None:
        """Start unconnected; `make_events` receives opened, data and the reason of a loss."""
        self.connections = 0
        self.last_fault = ""
        self._network, self._port, self._make_events = network, port, make_events
        self._stream: MemoryStream | None = None
        self._rest = b""  # bytes not yet accepted by the stream
        self._lost = ""
        self._next_attempt_ns = 0

    def poll(self, now_ns: int) -> Events:
        """Connect if due, receive, send the rest; return the events."""
        opened, data = False, b""
        if self._stream is None and not self._lost and now_ns >= self._next_attempt_ns:
            try:
                self._stream = self._network.dial(self._port)
            except OSError as error:
                self.close(str(error), now_ns)
            else:
                self.connections += 1
                opened = True
        if self._stream is not None:
            data = self._receive(now_ns)
            self._flush(now_ns)
        lost, self._lost = self._lost, ""
        return self._make_events(opened, data, lost)

    def send(self, data: bytes, now_ns: int) -> bool:
        """Send bytes; return False without a connection."""
        if self._stream is None:
            return False
        self._rest += data
        self._flush(now_ns)
        return self._stream is not None

    def greeted(self) -> None:
        """Do nothing: there is no back-off to reset in virtual time."""

    def close(self, reason: str, now_ns: int) -> None:
        """Close the connection; the next one is opened after PAUSE_S."""
        if self._stream is not None:
            self._stream.close()
            self._lost = reason
        self.last_fault = reason
        self._stream, self._rest = None, b""
        self._next_attempt_ns = now_ns + round(PAUSE_S * NS_PER_S)

    def _receive(self, now_ns: int) -> bytes:
        assert self._stream is not None  # noqa: S101 - checked by the caller
        try:
            data = self._stream.receive(RECEIVE_BYTES)
        except OSError as error:
            self.close(str(error), now_ns)
            return b""
        if data == b"":
            self.close("closed by the controller", now_ns)
        return data or b""

    def _flush(self, now_ns: int) -> None:
        if self._stream is None or not self._rest:
            return
        try:
            self._rest = self._rest[self._stream.send(self._rest) :]
        except OSError as error:
            self.close(str(error), now_ns)


ByteStream = SocketStream | MemoryStream
Datagrams = SocketDatagrams | MemoryDatagrams
Listener = SocketListener | MemoryListener
Network = SocketNetwork | MemoryNetwork
