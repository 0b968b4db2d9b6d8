"""Unwrapped packet numbers: IDs wrap around after 500 000 packets, numbers do not. Pure.

Serial number arithmetic (RFC 1982) compares two IDs correctly within half the range only, which is
17 minutes at 250 Hz. The gateway therefore counts its packets, sends the number modulo 500 000 as
the ID, and converts the ID of a report back to the newest packet number that it can denote.
"""

from controller import packet_table
from controller.packet_table import ID_FIRST, ids_since

NONE_YET = -1  # less than the number of any packet


def number_of(id_: int) -> int:
    """Return the number from which to continue counting; NO_ID is permitted."""
    return (id_ - ID_FIRST) % packet_table.ID_COUNT


def id_of(number: int) -> int:
    """Return the ID of a packet number."""
    return ID_FIRST + number % packet_table.ID_COUNT


class EchoMark:
    """Last packet of a connection echoed by the reports; it only increases."""

    def __init__(self, hello: int) -> None:
        """Start a connection with the number of its hello."""
        self._oldest = hello
        self.number = NONE_YET

    def read(self, id_: int, newest: int) -> None:
        """Evaluate the ID of a report, which can be the echo of packets up to number `newest`.

        The ID of an earlier connection is ignored. If the last echo is more than one wraparound
        back, the ID may denote a packet in flight, with a probability of one in 500 000; that
        packet then counts as arrived some milliseconds early.
        """
        number = newest - ids_since(id_, id_of(newest))
        if number >= max(self._oldest, self.number):
            self.number = number
