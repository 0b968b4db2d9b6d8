"""Packet numbers behind IDs: IDs go round after 500 000 packets, numbers do not. Pure.

A comparison of two IDs is right for half a ring only, and 17 minutes at 250 Hz are more. So the
gateway counts its packets, sends the number as an ID, and turns the ID of a report back into the
number of the newest packet that it can mean.
"""

from controller import packet_table
from controller.packet_table import ID_FIRST, ids_since

NONE_YET = -1  # less than the number of any packet


def number_of(id_: int) -> int:
    """Return the number to count on from; NO_ID is as good as any."""
    return (id_ - ID_FIRST) % packet_table.ID_COUNT


def id_of(number: int) -> int:
    """Return the ID under which a packet travels."""
    return ID_FIRST + number % packet_table.ID_COUNT


class EchoMark:
    """The last packet of a connection that the reports have named; it only moves on."""

    def __init__(self, hello: int) -> None:
        """Start a connection with the number of its hello."""
        self._oldest = hello
        self.number = NONE_YET

    def read(self, id_: int, newest: int) -> None:
        """Take the ID of a report, which can be the echo of packets up to number `newest`.

        An ID that no such packet of this connection has is of an earlier one, and ignored. When the
        last echo lies more than a ring back, the ID may mean a packet that is on its way: one in
        500 000 chances, and then that packet counts as arrived some milliseconds early.
        """
        number = newest - ids_since(id_, id_of(newest))
        if number >= max(self._oldest, self.number):
            self.number = number
