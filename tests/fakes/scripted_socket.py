"""A TCP socket in memory with kernel replies that the test scripts, for faulty lines.

It keeps to socket(7) and tcp(7) as far as a client of one connection needs: every call returns at
once, a full buffer raises BlockingIOError, an end is empty bytes.
"""

import errno
import struct
from collections import deque
from typing import Any

HERE, THERE = ("192.168.0.1", 40_000), ("192.168.0.2", 49_152)


class ScriptedSocket:
    """A client's socket and the far end of its line."""

    def __init__(self) -> None:
        """Succeed at connect; accept and acknowledge everything."""
        self.connects: deque[int | OSError] = deque()  # answers of connect_ex, then 0
        self.arrived: deque[bytes | OSError] = deque()  # data of each recv, then nothing
        self.room: int | OSError = 1 << 30  # bytes that the kernel accepts from now on
        self.confirms = True  # whether the far end acknowledges accepted bytes
        self.outq_error: OSError | None = None  # of the ioctl that reads the unacknowledged bytes
        self.own_name: tuple[str, int] | OSError = HERE
        self.options: list[tuple[Any, ...]] = []
        self.timeouts_s: list[float] = []
        self.taken = b""
        self.receives = 0
        self.closed = False
        self._confirmed = 0

    # --- as the kernel ----------------------------------------------------------------------------

    def settimeout(self, timeout_s: float) -> None:
        """Store the time-out."""
        self.timeouts_s.append(timeout_s)

    def setsockopt(self, *option: Any) -> None:
        """Store the option."""
        self.options.append(option)

    def connect_ex(self, address: tuple[str, int]) -> int:
        """Return the next reply; name resolution raises."""
        assert address == THERE
        return int(_scripted_reply(self.connects.popleft()) if self.connects else 0)

    def recv(self, most: int) -> bytes:
        """Return the bytes that have arrived."""
        self.receives += 1
        if not self.arrived:
            raise BlockingIOError(errno.EAGAIN, "nothing there")
        data: bytes = _scripted_reply(self.arrived.popleft())
        assert len(data) <= most
        return data

    def send(self, data: bytes) -> int:
        """Accept as many bytes as there is room for."""
        room = min(int(_scripted_reply(self.room)), len(data))
        if room == 0:
            raise BlockingIOError(errno.EAGAIN, "no room")
        self.room = int(_scripted_reply(self.room)) - room
        self.taken += data[:room]
        return room

    def getsockname(self) -> tuple[str, int]:
        """Return this end's address."""
        name: tuple[str, int] = _scripted_reply(self.own_name)
        return name

    def getpeername(self) -> tuple[str, int]:
        """Return the other end's address."""
        return THERE

    def close(self) -> None:
        """Close the socket."""
        self.closed = True

    def outq(self, _request: int, _argument: bytes) -> bytes:
        """Return the number of unacknowledged bytes, like SIOCOUTQ."""
        if self.outq_error is not None:
            raise self.outq_error
        if self.confirms:
            self._confirmed = len(self.taken)
        return struct.pack("i", len(self.taken) - self._confirmed)


def _scripted_reply(answer: Any) -> Any:
    if isinstance(answer, OSError):
        raise answer
    return answer
