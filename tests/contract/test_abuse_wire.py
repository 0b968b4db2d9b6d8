"""Gateway and shipped program on a hostile wire, in lock step: every bound is virtual time.

Four questions after each abuse: did the fault take effect, was data accepted that was never sent,
did the arm stop in time, and did it rest until a person armed again.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.packet import PACKET_CHARS
from tests.contract.hostile import HostileCell
from tests.fakes.hostile_stream import MS, Abuse, Chop, Edit, Freeze, Gather, Reset

UP, DOWN = "to_controller", "to_gateway"
MOTIONS = ("goal", "stream", "feedback")
BRAKE_S = 0.06  # from 100 mm/s to rest
WATCHDOG_S = 0.25
WATCHDOG_CYCLES_S = 0.06  # two cycles of the watchdog
SILENCE_S = WATCHDOG_S + WATCHDOG_CYCLES_S + BRAKE_S
BEAT_S = 0.05  # a corrupted packet shows when the next one has filled it up to 63 characters
NOTICED_S = BEAT_S + BRAKE_S + 0.01
FOR_EVER_NS = 10**15


@dataclass(frozen=True)
class Case:
    """An abuse that must end in a hold, and the bound of its time."""

    make: Callable[[random.Random], Abuse]
    bound_s: float


def somewhere(rng: random.Random) -> int:
    """Return a number of bytes to pass: up to two packets, so that every byte is hit."""
    return rng.randrange(1, 2 * PACKET_CHARS)


def junk(rng: random.Random, count: int) -> bytes:
    """Return bytes that are in no valid packet."""
    return bytes(rng.choice(b"\x00\n\r\x1b\xff+.eExX_*~") for _ in range(count))


BREAKING = {
    "half a packet, then silence": Case(
        lambda r: Freeze(after=PACKET_CHARS + r.randrange(1, 63), for_ns=FOR_EVER_NS), SILENCE_S
    ),
    "a freeze of 3 s, then a burst": Case(lambda r: Freeze(after=somewhere(r)), SILENCE_S),
    "garbage between": Case(
        lambda r: Edit(after=somewhere(r), insert=junk(r, r.randrange(1, 200))), NOTICED_S
    ),
    "a byte more": Case(lambda r: Edit(after=somewhere(r), insert=junk(r, 1)), NOTICED_S),
    # Nothing may follow: the bytes in flight are a heartbeat, and this one never arrives.
    "a byte less": Case(lambda r: Edit(after=somewhere(r), drop=1), SILENCE_S),
    "a byte replaced": Case(
        lambda r: Edit(after=somewhere(r), drop=1, insert=junk(r, 1)), NOTICED_S
    ),
    "a reset": Case(lambda r: Reset(after=somewhere(r)), NOTICED_S),
}


@pytest.mark.parametrize(
    ("direction", "motion"), [*((UP, motion) for motion in MOTIONS), (DOWN, "stream")]
)
@pytest.mark.parametrize("name", BREAKING)
def test_an_abuse_ends_in_a_hold_that_only_arming_ends(
    name: str, direction: str, motion: str
) -> None:
    """In time, with nothing misread; the link is opened again, which moves nothing."""
    case, cell = BREAKING[name], HostileCell()
    cell.begin(motion)
    abuse = cell.network.strike(direction, case.make(random.Random(f"{name} {motion}")))
    cell.rig.advance(0.6)
    assert abuse.bites, "the abuse never bit"
    assert abuse.bitten_ns is not None
    took_s = (cell.stopped_ns(abuse.bitten_ns) - abuse.bitten_ns) / 1e9
    assert took_s <= case.bound_s
    assert cell.rig.state.hold_reason
    cell.assert_stays(0.3)
    cell.assert_nothing_misread()
    if isinstance(abuse, Freeze):
        if abuse.for_ns < FOR_EVER_NS:
            cell.assert_stays(2.6)  # until after the burst
        cell.wire.close("silent, as the socket's link finds", cell.rig.clock.now_ns())
    cell.assert_stays(0.5)
    cell.rig.wrench = None
    cell.assert_obeys_after_arming()
    cell.assert_nothing_misread()


# --- what must do no harm -------------------------------------------------------------------------

HARMLESS: dict[str, Callable[[], Abuse]] = {
    "100-byte chunks": lambda: Gather(size=100),
    "20 bytes a read": lambda: Chop(size=20),
    "two packets merged": lambda: Gather(size=126),
    "frozen for less than the watchdog": lambda: Freeze(after=400, for_ns=100 * MS),
}


@pytest.mark.parametrize("name", HARMLESS)
def test_how_bytes_are_cut_makes_no_difference(name: str) -> None:
    """Force feedback continues in the controller, on one connection; every packet is received."""
    cell = HostileCell()
    cell.network.standing = {UP: HARMLESS[name], DOWN: HARMLESS[name]}
    cell.begin("feedback")
    cell.rig.advance(0.7)
    assert cell.rig.state.hold_reason == ""
    assert len(cell.hops) == 1
    assert cell.network.hop.to_controller.abuse.bites
    assert cell.network.hop.to_gateway.abuse.bites
    cell.assert_nothing_misread()
    assert len(cell.accepted) * PACKET_CHARS <= len(cell.network.hop.to_controller.passed)


STRIKES = st.lists(
    st.tuples(
        st.sampled_from(sorted(BREAKING)), st.sampled_from([UP, DOWN]), st.randoms(),
        st.integers(1, 400),
    ), min_size=1, max_size=4,
)  # fmt: skip


@settings(max_examples=5)
@given(motion=st.sampled_from(MOTIONS), strikes=STRIKES)
def test_after_abuses_in_any_order_nothing_is_misread_and_the_arm_holds(
    motion: str, strikes: list[tuple[str, str, random.Random, int]]
) -> None:
    """Also of later connections, some milliseconds apart; then the arm stays at rest."""
    cell = HostileCell()
    cell.begin(motion)
    for name, direction, rng, pause_ms in strikes:
        cell.network.strike(direction, BREAKING[name].make(rng))
        cell.rig.advance(pause_ms * 1e-3)
    cell.rig.advance(SILENCE_S + 0.5)
    is_held = cell.rig.state.hold_reason
    for hop in cell.hops:  # unfreezes what was frozen
        hop.to_controller.abuse, hop.to_gateway.abuse = Abuse(), Abuse()
    if is_held:
        cell.assert_stays(1.0)
    cell.assert_nothing_misread()
