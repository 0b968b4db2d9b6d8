"""Being woken seldom: for a process that hears all of a cell and has time.

Half of what hearing 1500 messages a second costs is to be woken for each. The kernel can let bytes
wait until there are many (SO_RCVLOWAT, tcp(7)).
"""

import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

OPEN_FILES = Path("/proc/self/fd")
MANY_B = 16_384  # some 60 ms of a cell at work
AT_ONCE = 1
BUSY = 50  # messages in a step: with fewer there is nothing to be won
LOOKS = 20  # one in so many steps looks what connections there are


class Wakes:
    """The connections of this process, whoever in it has made them."""

    def __init__(self) -> None:
        """Be woken at once, until there is much to hear."""
        self._seldom = False
        self._steps = 0

    def step(self, heard: int) -> None:
        """After a busy step let what comes wait for more; after another, take it in at once.

        So what is too little to wake anybody is taken in two steps later at the latest.
        """
        was, self._seldom = self._seldom, heard >= BUSY
        if self._seldom != was or (self._seldom and self._steps % LOOKS == 0):
            for number in connections():  # also those that were made meanwhile
                _let_wait(number, MANY_B if self._seldom else AT_ONCE)
        self._steps += 1


def _let_wait(number: int, least_B: int) -> None:
    with suppress(OSError), _borrowed(number) as connection:  # it may have ended meanwhile
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, least_B)


def connections() -> list[int]:
    """Return the TCP connections that are open; where the system has no such list, none."""
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
    """Use an open file as the socket that it is, and leave it open. Raise OSError if it is none."""
    found = socket.socket(fileno=number)
    try:
        yield found
    finally:
        found.detach()
