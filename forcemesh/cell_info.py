"""What a client needs to know of a cell and asks its hub for: rates, deadlines, roles, the tool.

The hub answers a query on `<cell>/info` with it, from the cell file that it runs with. So a client
needs the address of a hub and the name of a cell, and no file.
"""

from typing import Any

from forcemesh.bus import FixedReply, Transport, query_hub
from forcemesh.codec import decode_record, encode_record
from forcemesh.messages import Finite, PoseRecord
from forcemesh.records import Record
from forcemesh.topics import INFO, Topic


class CellInfo(Record):
    """Facts of one cell, as its hub has read them."""

    cell: str
    config_hash: str  # of the cell file; every process of a cell reports the same
    roles: dict[str, str]  # the process that plays each role: `robot`: `sim`, `gateway`, `external`
    rates_hz: dict[str, Finite]  # by topic
    deadlines_s: dict[str, Finite]  # by topic: the age from which on it is stale
    T_flange_tcp: PoseRecord  # tool centre point in the flange frame
    touch_N: Finite  # contact begins above

    def rate_hz(self, topic: Topic[Any]) -> float:
        """Return how often a topic is published [Hz]."""
        return self.rates_hz[topic.key]

    def stale_after_s(self, topic: Topic[Any]) -> float:
        """Return the age [s] from which on a topic is stale."""
        return self.deadlines_s[topic.key]


def info_server(transport: Transport, info: CellInfo) -> FixedReply:
    """Return the hub's answer to clients."""
    return FixedReply(transport, f"{info.cell}/{INFO}", encode_record(info))


def ask_for_info(transport: Transport, cell: str, timeout_s: float = 2.0) -> CellInfo:
    """Return the facts of a cell from its hub. Raise LostError when it does not answer."""
    hint = f": is {cell} the cell's name?"
    return decode_record(query_hub(transport, f"{cell}/{INFO}", timeout_s, hint), CellInfo)
