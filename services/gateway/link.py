"""TCP link to the controller: the gateway's one socket, non-blocking, without exceptions.

`poll` and `send` return at once and convert every failure into a reason. A lost connection is
reopened with exponential backoff, which a valid hello resets. The link is closed on silence and on
data that the peer's TCP does not acknowledge.
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
TCP_RECEIVES_PER_POLL = 4  # bounds the time that a flood of data can take from the loop


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Address of the controller, and timeouts."""

    host: str
    port: int
    connect_within_s: float = 1.0
    pause_first_s: float = 0.1
    pause_longest_s: float = 2.0
    # Longest time with more than one packet that the peer's TCP has not acknowledged.
    stalled_after_s: float = 0.2
    silent_after_s: float = 1.5  # the controller sends continuously; planning stalls it under 1 s


@dataclass(frozen=True, slots=True)
class LinkEvents:
    """Events of the link since the last poll, in this order."""

    opened: bool = False
    data: bytes = b""
    lost: str = ""  # why the connection ended, empty if it did not


class Link:
    """TCP connection to the controller."""

    def __init__(self, settings: LinkSettings) -> None:
        """Store the settings; the first `poll` opens the connection."""
        self.settings = settings
        self.connections = 0
        self.last_fault = ""
        self.is_open = False  # the connection is established
        self._socket: socket.socket | None = None
        self._lost = ""
        self._since_ns = 0  # start of the attempt, then time of the last data received
        self._pause_s = settings.pause_first_s
        self._next_attempt_ns = 0
        self._rest = b""  # not accepted by the kernel yet
        self._sent_bytes = 0
        self._unconfirmed: deque[tuple[int, int]] = deque()  # stream position, time of `send`

    def poll(self, now_ns: int) -> LinkEvents:
        """Open, receive and supervise the connection; return its events."""
        opened, data = False, b""
        if not self.is_open and not self._lost and now_ns >= self._next_attempt_ns:
            opened = self._connect(now_ns)
        if self.is_open and self._socket is not None:
            data = self._receive(self._socket, now_ns)
            self._flush(now_ns)
            self._watch(now_ns)
        lost, self._lost = self._lost, ""
        return LinkEvents(opened, data, lost)

    def send(self, data: bytes, now_ns: int) -> bool:
        """Queue bytes for sending; False without a connection (`poll` returns the reason)."""
        if not self.is_open:
            return False
        self._rest += data
        self._flush(now_ns)
        return self.is_open

    def greeted(self) -> None:
        """Register a valid hello, which resets the backoff."""
        self._pause_s = self.settings.pause_first_s

    def close(self, reason: str, now_ns: int) -> None:
        """Close the connection; the next one is opened after the pause."""
        if self._socket is not None:
            self._socket.close()
        if self.is_open:
            self._lost = reason
        self.last_fault = reason
        self._socket, self.is_open = None, False
        self._rest, self._sent_bytes = b"", 0
        self._unconfirmed.clear()
        self._next_attempt_ns = now_ns + round(self._pause_s * NS_PER_S)
        self._pause_s = min(2.0 * self._pause_s, self.settings.pause_longest_s)

    # --- inside -----------------------------------------------------------------------------------

    def _connect(self, now_ns: int) -> bool:
        """Start or continue a connection attempt; return whether the connection is open."""
        if self._socket is None:
            self._since_ns = now_ns
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._socket.settimeout(0.0)
            # Nagle's algorithm would delay a set point until the one before is acknowledged.
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
            self.close(f"{self._where}: no server listens there", now_ns)
            return False
        self.is_open, self._since_ns = True, now_ns
        self.connections += 1
        return True

    def _receive(self, sock: socket.socket, now_ns: int) -> bytes:
        received = b""
        for _ in range(TCP_RECEIVES_PER_POLL):
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
        """Close on silence, and on data that stays unacknowledged."""
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
            text = f"{waiting} bytes not acknowledged for {age_s * 1e3:.0f} ms"
            self.close(f"{self._where}: {text}", now_ns)

    @property
    def _where(self) -> str:
        return f"controller {self.settings.host}:{self.settings.port}"


def _unacknowledged_bytes(sock: socket.socket) -> int:
    """Return the bytes that the peer has not acknowledged (SIOCOUTQ, tcp(7)); 0 if unknown."""
    try:
        answer = fcntl.ioctl(sock, termios.TIOCOUTQ, struct.pack("i", 0))
    except OSError:
        return 0
    return int(struct.unpack("i", answer)[0])


def _is_its_own_peer(sock: socket.socket) -> bool:
    """Return whether TCP connected the socket to itself: an unused port of the local range."""
    try:
        return bool(sock.getsockname() == sock.getpeername())
    except OSError:  # closed already: the first receive returns the reason
        return False
