"""Network faults on a cable, with verification.

A fault begins, ends, and returns its number of effects (`bites`): dropped packets, lost carrier. A
trial with a fault without effect is not valid.
"""

import json
from dataclasses import dataclass
from typing import Literal, Protocol

from tests.chaos.network_lab import Cable

Ends = Literal["held", "went on", "either"]

TABLE = "chaos"


class NetworkFault(Protocol):
    """One kind of fault on a wire."""

    @property
    def lasts_s(self) -> float:
        """Duration [s]."""

    @property
    def ends(self) -> Ends:
        """Expected result: the arm is held, is not held, or either."""

    def begin(self, wire: Cable) -> None:
        """Apply the fault."""

    def end(self, wire: Cable) -> int:
        """Remove the fault; return its number of effects."""


@dataclass(frozen=True, slots=True)
class LinkDown:
    """Unplugged cable: link down, then up."""

    lasts_s: float = 1.0
    ends: Ends = "held"

    def begin(self, wire: Cable) -> None:
        """Set the link down at the far end."""
        wire.at_far_end("ip", "link", "set", wire.far_device, "down")

    def end(self, wire: Cable) -> int:
        """Set the link up; return whether the near end had lost its carrier."""
        flags = wire.near.link(wire.near_device)["flags"]
        wire.at_far_end("ip", "link", "set", wire.far_device, "up")
        return int("NO-CARRIER" in flags)


@dataclass(frozen=True, slots=True)
class Nothing:
    """Control trial without a fault: the arm must continue; shows its normal speed."""

    lasts_s: float = 1.0
    ends: Ends = "went on"

    def begin(self, wire: Cable) -> None:
        """Do nothing."""

    def end(self, wire: Cable) -> int:
        """Return the packets since the cable was created: not 0 if it is the right one."""
        stats = wire.near.link(wire.near_device)["stats64"]
        return int(stats["rx"]["packets"] + stats["tx"]["packets"])


@dataclass(frozen=True, slots=True)
class PacketFilter:
    """Packet filter at the near end, on incoming or outgoing packets or both."""

    what: str  # nft statement after the match
    directions: tuple[Literal["in", "out"], ...] = ("in", "out")
    lasts_s: float = 1.0
    ends: Ends = "held"

    def begin(self, wire: Cable) -> None:
        """Load the rules."""
        wire.near.run("nft", f"add table inet {TABLE}; " + "; ".join(self._rules(wire)))

    def end(self, wire: Cable) -> int:
        """Remove the rules; return the packet counter."""
        counters_json = json.loads(
            wire.near.run("nft", "-j", "list", "counter", "inet", TABLE, "bites")
        )
        wire.near.run("nft", f"delete table inet {TABLE}")
        counters = [entry["counter"] for entry in counters_json["nftables"] if "counter" in entry]
        return int(counters[0]["packets"])

    def _rules(self, wire: Cable) -> list[str]:
        rules = [f"add counter inet {TABLE} bites"]
        for direction in self.directions:
            hook = {"in": "input", "out": "output"}[direction]
            match = f'{direction[0]}ifname "{wire.near_device}"'
            rules += [
                f"add chain inet {TABLE} {hook} {{ type filter hook {hook} priority 0 ; }}",
                f"add rule inet {TABLE} {hook} {match} {self.what}",
            ]
        return rules


@dataclass(frozen=True, slots=True)
class Slow:
    """Bandwidth limit: excess packets are queued, then dropped."""

    rate: str
    lasts_s: float = 2.0
    ends: Ends = "either"

    def begin(self, wire: Cable) -> None:
        """Add a token bucket at both ends."""
        bucket = ("tbf", "rate", self.rate, "burst", "3000", "limit", "30000")
        wire.near.run("tc", "qdisc", "add", "dev", wire.near_device, "root", *bucket)
        wire.at_far_end("tc", "qdisc", "add", "dev", wire.far_device, "root", *bucket)

    def end(self, wire: Cable) -> int:
        """Remove both; return the number of packets that passed through them."""
        show = ("tc", "-s", "-j", "qdisc", "show", "dev")
        counters_json = json.loads(wire.near.run(*show, wire.near_device))
        counters_json += json.loads(wire.at_far_end(*show, wire.far_device))
        wire.near.run("tc", "qdisc", "del", "dev", wire.near_device, "root")
        wire.at_far_end("tc", "qdisc", "del", "dev", wire.far_device, "root")
        return sum(
            int(qdisc.get("packets", 0)) for qdisc in counters_json if qdisc["kind"] == "tbf"
        )


def _lost(percent: int) -> str:
    return f"numgen random mod 100 < {percent} counter name bites drop"


FAULTS: dict[str, NetworkFault] = {
    "none": Nothing(),
    "link-down": LinkDown(),
    "drop-in": PacketFilter("counter name bites drop", ("in",)),
    "drop-out": PacketFilter("counter name bites drop", ("out",)),
    "loss-1": PacketFilter(_lost(1), lasts_s=2.0, ends="either"),
    "loss-5": PacketFilter(_lost(5), lasts_s=2.0, ends="either"),
    # Long enough for both ends to send; a new connection must succeed afterwards.
    "reset": PacketFilter(
        "meta l4proto tcp counter name bites reject with tcp reset", lasts_s=0.1, ends="either"
    ),
    "256-kbit": Slow("256kbit"),  # less than a quarter of a service's full data rate
    "64-kbit": Slow("64kbit"),  # half of the data rate between gateway and controller
}
