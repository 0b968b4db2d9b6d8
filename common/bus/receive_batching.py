"""Receive batching (SO_RCVLOWAT) for a process that reads all topics without deadline.

Half of the CPU cost of receiving 1500 messages a second is the wake-up for each. The kernel can
delay the wake-up until many bytes have arrived (SO_RCVLOWAT, tcp(7)).
"""

import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

OPEN_FILES = Path("/proc/self/fd")
MANY_B = 16_384  # about 60 ms of an active cell
AT_ONCE = 1
BUSY = 50  # messages in a step: with fewer, batching has no benefit
SEARCH_STEPS = 20  # steps between searches for new connections


class ReceiveBatching:
    """Receive batching on all TCP connections of this process."""

    def __init__(self) -> None:
        """Start without batching."""
        self._seldom = False
        self._steps = 0

    def step(self, received: int) -> None:
        """Enable batching after a busy step, disable it after another.

        Bytes below the threshold are therefore read two steps later at the latest.
        """
        was, self._seldom = self._seldom, received >= BUSY
        if self._seldom != was or (self._seldom and self._steps % SEARCH_STEPS == 0):
            for number in connections():  # also new ones
                _let_wait(number, MANY_B if self._seldom else AT_ONCE)
        self._steps += 1


def _let_wait(number: int, least_B: int) -> None:
    with suppress(OSError), _borrowed(number) as connection:  # it may have ended meanwhile
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, least_B)


def connections() -> list[int]:
    """Return the open TCP connections; empty if the system has no such list."""
    found = []
    with suppress(OSError):
        for number in [int(entry.name) for entry in OPEN_FILES.iterdir()]:
            with suppress(OSError), _borrowed(number) as one:
                one.getpeername()
                is_tcp = one.family in (socket.AF_INET, socket.AF_INET6)
                found += [number] if is_tcp and one.type == socket.SOCK_STREAM else []
    return found


@contextmanager
def _borrowed(number: int) -> Iterator[socket.socket]:
    """Use an open file as a socket, and leave it open. Raise OSError if it is not a socket."""
    found = socket.socket(fileno=number)
    try:
        yield found
    finally:
        found.detach()
