"""What can happen to a cable, and the proof that it did.

A fault begins, ends, and says how often it bit: a packet that was dropped, a carrier that was gone.
One that never bit has tested nothing.
"""

import json
from dataclasses import dataclass
from typing import Literal, Protocol

from tests.chaos.network_lab import Wire

Ends = Literal["held", "went on", "either"]

TABLE = "chaos"


class Fault(Protocol):
    """One kind of trouble on a wire."""

    @property
    def lasts_s(self) -> float:
        """How long it lasts [s]."""

    @property
    def ends(self) -> Ends:
        """Whether the arm must be held by it, must not be, or either."""

    def begin(self, wire: Wire) -> None:
        """Let it happen."""

    def end(self, wire: Wire) -> int:
        """Undo it; return how often it bit."""


@dataclass(frozen=True, slots=True)
class LinkDown:
    """The cable is pulled and put back."""

    lasts_s: float = 1.0
    ends: Ends = "held"

    def begin(self, wire: Wire) -> None:
        """Pull it at the far end."""
        wire.at_far_end("ip", "link", "set", wire.far_device, "down")

    def end(self, wire: Wire) -> int:
        """Put it back; it bit when the near end had no carrier."""
        flags = wire.near.link(wire.near_device)["flags"]
        wire.at_far_end("ip", "link", "set", wire.far_device, "up")
        return int("NO-CARRIER" in flags)


@dataclass(frozen=True, slots=True)
class Nothing:
    """The control: the arm must go on, and shows how fast it is when nothing is wrong."""

    lasts_s: float = 1.0
    ends: Ends = "went on"

    def begin(self, wire: Wire) -> None:
        """Let everything be."""

    def end(self, wire: Wire) -> int:
        """Count the packets since the cable was made: there are some, if it is the right one."""
        stats = wire.near.link(wire.near_device)["stats64"]
        return int(stats["rx"]["packets"] + stats["tx"]["packets"])


@dataclass(frozen=True, slots=True)
class Filter:
    """The near end's packet filter does something to what comes in, goes out, or both."""

    what: str  # of nft, after the match
    directions: tuple[Literal["in", "out"], ...] = ("in", "out")
    lasts_s: float = 1.0
    ends: Ends = "held"

    def begin(self, wire: Wire) -> None:
        """Load the rules."""
        wire.near.run("nft", f"add table inet {TABLE}; " + "; ".join(self._rules(wire)))

    def end(self, wire: Wire) -> int:
        """Take the rules away; it bit as often as the counter says."""
        said = json.loads(wire.near.run("nft", "-j", "list", "counter", "inet", TABLE, "bites"))
        wire.near.run("nft", f"delete table inet {TABLE}")
        counters = [entry["counter"] for entry in said["nftables"] if "counter" in entry]
        return int(counters[0]["packets"])

    def _rules(self, wire: Wire) -> list[str]:
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
    """A line that carries little: what does not fit waits, and then is dropped."""

    rate: str
    lasts_s: float = 2.0
    ends: Ends = "either"

    def begin(self, wire: Wire) -> None:
        """Put a token bucket on both ends."""
        bucket = ("tbf", "rate", self.rate, "burst", "3000", "limit", "30000")
        wire.near.run("tc", "qdisc", "add", "dev", wire.near_device, "root", *bucket)
        wire.at_far_end("tc", "qdisc", "add", "dev", wire.far_device, "root", *bucket)

    def end(self, wire: Wire) -> int:
        """Take both away; they bit as often as a packet went through them."""
        show = ("tc", "-s", "-j", "qdisc", "show", "dev")
        said = json.loads(wire.near.run(*show, wire.near_device))
        said += json.loads(wire.at_far_end(*show, wire.far_device))
        wire.near.run("tc", "qdisc", "del", "dev", wire.near_device, "root")
        wire.at_far_end("tc", "qdisc", "del", "dev", wire.far_device, "root")
        return sum(int(qdisc.get("packets", 0)) for qdisc in said if qdisc["kind"] == "tbf")


def _lost(percent: int) -> str:
    return f"numgen random mod 100 < {percent} counter name bites drop"


FAULTS: dict[str, Fault] = {
    "none": Nothing(),
    "link-down": LinkDown(),
    "drop-in": Filter("counter name bites drop", ("in",)),
    "drop-out": Filter("counter name bites drop", ("out",)),
    "loss-1": Filter(_lost(1), lasts_s=2.0, ends="either"),
    "loss-5": Filter(_lost(5), lasts_s=2.0, ends="either"),
    # Long enough that both ends send something; a new connection must come through afterwards.
    "reset": Filter(
        "meta l4proto tcp counter name bites reject with tcp reset", lasts_s=0.1, ends="either"
    ),
    "256-kbit": Slow("256kbit"),  # less than a quarter of what a service says at full rate
    "64-kbit": Slow("64kbit"),  # half of what gateway and controller say to each other
}
