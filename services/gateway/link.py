"""The one socket of the gateway: TCP client of the controller, never blocking, never raising.

`poll` and `send` return at once and turn every failure into a reason; a lost connection is opened
again after a pause that grows until the controller has greeted us.
"""

import errno
import fcntl
import os
import socket
import struct
import termios
from collections import deque
from dataclasses import dataclass

from controller.packet import PACKET_CHARS
from forcemesh.clock import NS_PER_S

RECEIVE_BYTES = 16_384
RECEIVES_PER_POLL = 4  # a peer that floods us cannot keep the loop


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Where the controller is and how long it may take."""

    host: str
    port: int
    connect_within_s: float = 1.0
    pause_first_s: float = 0.1
    pause_longest_s: float = 2.0
    # More than one packet that the peer's TCP has not taken for this long: it reads no more.
    stalled_after_s: float = 0.2
    silent_after_s: float = 1.5  # the controller sends endlessly; a planning stall is under 1 s


@dataclass(frozen=True, slots=True)
class News:
    """What happened on the link since the last poll, in this order."""

    opened: bool = False
    data: bytes = b""
    lost: str = ""  # why the connection ended, empty while it did not


class Link:
    """TCP connection to the controller."""

    def __init__(self, settings: LinkSettings) -> None:
        """Open nothing yet: the first `poll` does."""
        self.settings = settings
        self.connections = 0
        self.last_fault = ""
        self._socket: socket.socket | None = None
        self._open = False
        self._lost = ""
        self._since_ns = 0  # start of the attempt, then of the silence
        self._pause_s = settings.pause_first_s
        self._next_attempt_ns = 0
        self._rest = b""  # what the kernel did not take
        self._sent_bytes = 0
        self._unconfirmed: deque[tuple[int, int]] = deque()  # stream position, handed over at

    @property
    def is_open(self) -> bool:
        """The connection is established."""
        return self._open

    def poll(self, now_ns: int) -> News:
        """Open, receive, and watch; return what happened."""
        opened, data = False, b""
        if not self._open and not self._lost and now_ns >= self._next_attempt_ns:
            opened = self._connect(now_ns)
        if self._open and self._socket is not None:
            data = self._receive(self._socket, now_ns)
            self._flush(now_ns)
            self._watch(now_ns)
        lost, self._lost = self._lost, ""
        return News(opened, data, lost)

    def send(self, data: bytes, now_ns: int) -> bool:
        """Hand bytes over; False when there is no connection (the reason comes with `poll`)."""
        if not self._open:
            return False
        self._rest += data
        self._flush(now_ns)
        return self._open

    def greeted(self) -> None:
        """Tell that the controller said hello well: the next pause is short again."""
        self._pause_s = self.settings.pause_first_s

    def close(self, reason: str, now_ns: int) -> None:
        """Give the connection up; the next one is opened after the pause."""
        if self._socket is not None:
            self._socket.close()
        if self._open:
            self._lost = reason
        self.last_fault = reason
        self._socket, self._open = None, False
        self._rest, self._sent_bytes = b"", 0
        self._unconfirmed.clear()
        self._next_attempt_ns = now_ns + round(self._pause_s * NS_PER_S)
        self._pause_s = min(2.0 * self._pause_s, self.settings.pause_longest_s)

    # --- inside -----------------------------------------------------------------------------------

    def _connect(self, now_ns: int) -> bool:
        """Start a connection or look after one that is being made; tell whether it is open."""
        if self._socket is None:
            self._since_ns = now_ns
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._socket.settimeout(0.0)
            # Nagle would hold a set point back until the one before is acknowledged.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            code = self._socket.connect_ex((self.settings.host, self.settings.port))
        except OSError as error:  # a name that does not resolve
            self.close(f"{self._where}: {error}", now_ns)
            return False
        if code in {errno.EINPROGRESS, errno.EALREADY}:
            if now_ns - self._since_ns > self.settings.connect_within_s * NS_PER_S:
                self.close(f"{self._where}: no answer", now_ns)
            return False
        if code not in {0, errno.EISCONN}:
            self.close(f"{self._where}: {os.strerror(code)}, is its program running?", now_ns)
            return False
        if _is_its_own_peer(self._socket):
            self.close(f"{self._where}: nobody listens there", now_ns)
            return False
        self._open, self._since_ns = True, now_ns
        self.connections += 1
        return True

    def _receive(self, sock: socket.socket, now_ns: int) -> bytes:
        received = b""
        for _ in range(RECEIVES_PER_POLL):
            try:
                data = sock.recv(RECEIVE_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                self.close(f"{self._where}: {error.strerror or error}", now_ns)
                break
            if not data:
                self.close(f"{self._where}: closed by the controller", now_ns)
                break
            received += data
        if received:
            self._since_ns = now_ns
        return received

    def _flush(self, now_ns: int) -> None:
        while self._socket is not None and self._rest:
            try:
                taken = self._socket.send(self._rest)
            except BlockingIOError:
                break
            except OSError as error:
                self.close(f"{self._where}: {error.strerror or error}", now_ns)
                return
            self._rest = self._rest[taken:]
            self._sent_bytes += taken
        handed_over = self._sent_bytes + len(self._rest)
        if handed_over and (not self._unconfirmed or self._unconfirmed[-1][0] < handed_over):
            self._unconfirmed.append((handed_over, now_ns))

    def _watch(self, now_ns: int) -> None:
        """Close on silence, and on packets that lie about unread on their way."""
        if self._socket is None:
            return
        if now_ns - self._since_ns > self.settings.silent_after_s * NS_PER_S:
            self.close(f"{self._where}: silent for {self.settings.silent_after_s:g} s", now_ns)
            return
        waiting = len(self._rest) + _unacknowledged_bytes(self._socket)
        confirmed = self._sent_bytes + len(self._rest) - waiting
        while self._unconfirmed and self._unconfirmed[0][0] <= confirmed:
            self._unconfirmed.popleft()
        if not self._unconfirmed or waiting <= PACKET_CHARS:
            return
        age_s = (now_ns - self._unconfirmed[0][1]) / NS_PER_S
        if age_s > self.settings.stalled_after_s:
            text = f"{waiting} bytes not taken for {age_s * 1e3:.0f} ms"
            self.close(f"{self._where}: {text}", now_ns)

    @property
    def _where(self) -> str:
        return f"controller {self.settings.host}:{self.settings.port}"


def _unacknowledged_bytes(sock: socket.socket) -> int:
    """Return what the peer's TCP has not acknowledged (SIOCOUTQ, tcp(7)); 0 where unknown."""
    try:
        answer = fcntl.ioctl(sock, termios.TIOCOUTQ, struct.pack("i", 0))
    except OSError:
        return 0
    return int(struct.unpack("i", answer)[0])


def _is_its_own_peer(sock: socket.socket) -> bool:
    """TCP lets a socket connect to itself when nobody listens on a port of the local range."""
    try:
        return bool(sock.getsockname() == sock.getpeername())
    except OSError:  # gone again already: the first receive will say why
        return False
