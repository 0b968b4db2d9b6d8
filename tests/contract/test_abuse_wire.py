"""Gateway and shipped program on a hostile wire, in lock step: every bound is virtual time.

Four questions after each abuse: did the fault take effect, was data accepted that was never sent,
did the arm stop in time, and did it rest until a person armed again.
"""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.load import load_cell
from controller.packet import PACKET_CHARS, Packet, encode
from controller.packet_table import ID_FIRST, Com
from forcemesh import topics
from forcemesh.messages import Host
from forcemesh.requests import ForceStartRequest
from sim.controller.behaviour import Behaviour, pessimistic
from tests.contract.hostile import ARM_STILL_RAD, HostileCell
from tests.contract.robots import GOOD
from tests.fakes.controller import PORT
from tests.fakes.controller_talk import HELLO_PARAM
from tests.fakes.hostile_stream import (
    MS,
    Abuse,
    Chop,
    Edit,
    Freeze,
    Gather,
    Reset,
    Rewrite,
    Throttle,
)
from tests.fakes.lab import Lab

UP, DOWN = "to_controller", "to_gateway"
MOTIONS = ("goal", "stream", "feedback")
BRAKE_S = 0.06  # from 100 mm/s to rest
WATCHDOG_S = 0.25
WATCHDOG_CYCLES_S = 0.06  # two cycles of the watchdog
SILENCE_S = WATCHDOG_S + WATCHDOG_CYCLES_S + BRAKE_S
BEAT_S = 0.05  # a corrupted packet shows when the next one has filled it up to 63 characters
NOTICED_S = BEAT_S + BRAKE_S + 0.01
FOR_EVER_NS = 10**15
REST_S = 0.07  # BRAKE_S, and the steps of the rig
LINK_SILENCE_S = 1.5  # after which the gateway's socket closes a silent connection
TCP_CELL = Path(__file__).resolve().parents[2] / "cells" / "demo-tcp.yaml"
WORSE = pessimistic(GOOD.step_s)
BEHAVIOURS = pytest.mark.parametrize("behaviour", [GOOD, WORSE], ids=["kind", "pessimistic"])


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


# --- peers that vanish, intrude or starve the controller ------------------------------------------


def segment_s(behaviour: Behaviour) -> float:
    """Duration of a segment from rest to rest: its planned time, or by its acceleration."""
    planned_s = 0.031
    return max(planned_s, 2.0 * math.sqrt(planned_s * behaviour.accel_time_s))


def give_up(cell: HostileCell) -> None:
    """Advance until the gateway detects unacknowledged packets, or its link the silence."""
    cell.rig.advance(LINK_SILENCE_S)
    if len(cell.hops) == 1:
        cell.wire.close("silent", cell.rig.clock.now_ns())


# --- a peer that vanishes -------------------------------------------------------------------------


@BEHAVIOURS
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_gateway_that_vanishes_without_closing_is_missed_by_the_watchdog(
    behaviour: Behaviour, motion: str
) -> None:
    """Without FIN and RST: the arm holds in time, and the next connection is accepted."""
    cell = HostileCell(behaviour)
    cell.begin(motion)
    vanished_ns = cell.rig.clock.now_ns()
    cell.network.hop.vanished = True
    give_up(cell)
    assert (cell.stopped_ns(vanished_ns) - vanished_ns) / 1e9 <= SILENCE_S
    assert cell.rig.advance(4.0, lambda: len(cell.hops) == 2 and cell.rig.state.valid)
    cell.assert_stays(0.5)
    cell.rig.wrench = None
    cell.assert_obeys_after_arming()
    cell.assert_nothing_misread()


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_gateway_that_is_killed_leaves_an_arm_that_holds(
    motion: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its connection ends with it and no other begins: a hold before the watchdog would act."""
    cell = HostileCell()
    cell.begin(motion)
    killed_ns = cell.rig.clock.now_ns()
    monkeypatch.setattr(cell.gateway, "step", lambda _now_ns: None)
    cell.wire.close("killed", killed_ns)
    cell.rig.advance(0.5)
    assert (cell.stopped_ns(killed_ns) - killed_ns) / 1e9 < WATCHDOG_S
    cell.assert_stays(0.5)


@BEHAVIOURS
def test_a_gateway_that_vanishes_while_nothing_moves_does_not_block_the_next(
    behaviour: Behaviour,
) -> None:
    """The watchdog is off then; the sender detects that its data is not acknowledged."""
    cell = HostileCell(behaviour)
    cell.rig.connect()
    cell.network.hop.vanished = True
    give_up(cell)
    assert cell.rig.advance(8.0, lambda: cell.rig.state.valid), cell.rig.state.reason
    cell.rig.advance(2.0)
    cell.assert_obeys_after_arming()
    cell.assert_nothing_misread()


# --- a second client ------------------------------------------------------------------------------


def intruder_bytes(*coms: int) -> bytes:
    """Return valid bytes of an unexpected client: hello, then more."""
    hello = encode(Packet(ID_FIRST, Com.HELLO, HELLO_PARAM, (50, 500, 250, 100, 1000, 10)))
    return hello + b"".join(
        encode(Packet(n, com)) for n, com in enumerate(coms, start=ID_FIRST + 1)
    )


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_second_client_is_ignored_while_the_gateway_is_connected(motion: str) -> None:
    """Its hold, motion and garbage are ignored; it receives no byte; the gateway continues."""
    cell = HostileCell()
    cell.begin(motion)
    intruders = [
        cell.network.intrude(PORT, data)
        for data in (intruder_bytes(8), intruder_bytes(2), b"\x00" * 99)
    ]
    cell.rig.advance(0.3)
    assert cell.moves
    assert cell.rig.state.hold_reason == ""
    assert [intruder.receive(100) for intruder in intruders] == [None] * 3
    cell.assert_nothing_misread()


def test_a_client_that_waited_is_served_after_the_gateway_and_the_arm_holds_meanwhile() -> None:
    """The controller serves one client after the other; the gateway connects and nothing moved."""
    cell = HostileCell()
    cell.begin("goal")
    intruder = cell.network.intrude(PORT, intruder_bytes())
    cell.wire.close("cut by the test", cell.rig.clock.now_ns())
    cell.rig.advance(0.5)
    assert (intruder.receive(63) or b"")[7:13] == b"000009"
    assert not cell.rig.state.valid
    cell.assert_stays(1.0)
    intruder.close()
    cell.rig.connect()
    cell.assert_stays(0.5)
    cell.assert_obeys_after_arming()


# --- the wrench stops while the link lives --------------------------------------------------------


@BEHAVIOURS
def test_without_new_wrenches_the_program_holds_although_the_link_is_up(
    behaviour: Behaviour,
) -> None:
    """The gateway sends each wrench as a heartbeat: packets arrive, and the watchdog still trips.

    The correction ends with the last wrench: it waits for the segment before it, and is one itself.
    The latch follows within the watchdog's time.
    """
    cell = HostileCell(behaviour)
    cell.begin("feedback")
    starved_ns = cell.rig.clock.now_ns()
    beat = encode(Packet(ID_FIRST, Com.HEARTBEAT))[7:]
    abuse = cell.network.strike(
        UP, Rewrite(turn=lambda p: p[:7] + beat if p[7:13] == b"000004" else p)
    )
    assert cell.rig.advance(SILENCE_S, lambda: cell.machine.memory.read("fm.lat") == 2.0)
    assert abuse.bites >= 3
    cell.rig.advance(0.005)
    assert cell.machine.memory.read("fm.fault") == 2.0
    stopped_s = (cell.stopped_ns(starved_ns) - starved_ns) / 1e9
    assert stopped_s <= REST_S + 2 * segment_s(behaviour)
    cell.assert_stays(1.0)


@pytest.mark.parametrize("host", ["pc", "controller"])
def test_without_wrenches_the_whole_cell_holds_although_every_link_is_up(host: Host) -> None:
    """All services, gateway and program in lock step; the wrench's process ends on the approach.

    Bound: the wrench's deadline in this cell, one set point in flight, the braking time.
    """
    lab = Lab(load_cell(TCP_CELL, {"sim.gap_m": 0.1}))
    start = ForceStartRequest(mode="position", host=host, setpoint_N=10.0)
    assert lab.ask(topics.FORCE_START, start).accepted
    lab.cell.advance(0.6)
    before = lab.q_command()
    lab.cell.advance(0.1)
    assert np.abs(lab.q_command() - before).max() > 1e-4, "it was not on its way"
    lab.cell.kill("wrench")
    lab.cell.advance(lab.cell.cell.stale_after_s(topics.WRENCH) + 0.05 + REST_S)
    lab.assert_still(1.0)
    assert "wrench" in lab.state.hold_reason


# --- a slow line ----------------------------------------------------------------------------------


@pytest.mark.parametrize("bytes_per_s", [1400, 500])
def test_a_hold_does_not_wait_behind_heartbeats_on_a_slow_line(bytes_per_s: int) -> None:
    """Or the arm holds by its watchdog before; packets beyond the line's rate must not queue."""
    cell = HostileCell()
    cell.rig.connect()
    cell.rig.arm()
    abuse = cell.network.strike(UP, Throttle(bytes_per_s=bytes_per_s))
    cell.rig.advance(3.0)
    assert abuse.bites
    before = cell.machine.memory.read("fm.hseq"), cell.machine.memory.read("fm.wseq")
    cell.rig.send_hold()
    assert cell.rig.advance(
        SILENCE_S + 0.1,
        lambda: (
            (cell.machine.memory.read("fm.hseq"), cell.machine.memory.read("fm.wseq")) != before
        ),
    )


# --- a person at the pendant ----------------------------------------------------------------------


@BEHAVIOURS
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.long
def test_run_on_the_pendant_after_a_hold_moves_nothing(behaviour: Behaviour, motion: str) -> None:
    """Neither the motion that HOLD interrupted nor later commands; a person arms first."""
    cell = HostileCell(behaviour)
    cell.begin(motion)
    held_ns = cell.rig.clock.now_ns()
    cell.machine.pendant.hold()
    cell.rig.advance(0.5)
    assert (cell.stopped_ns(held_ns) - held_ns) / 1e9 <= REST_S
    q = cell.joints[-1]
    cell.machine.pendant.run()
    cell.rig.advance(3.0)
    assert np.abs(cell.joints[-1] - q).max() <= ARM_STILL_RAD
    cell.assert_stays(0.5)
    cell.rig.wrench = None
    cell.assert_obeys_after_arming()
    cell.assert_nothing_misread()


@pytest.mark.parametrize("motion", ["goal", "feedback"])
def test_run_on_the_pendant_after_the_gateway_vanished_moves_nothing(motion: str) -> None:
    """Hold, then loss of the link, then RUN: the hold persists."""
    cell = HostileCell()
    cell.begin(motion)
    cell.machine.pendant.hold()
    cell.network.hop.vanished = True
    cell.rig.advance(0.5)
    cell.machine.pendant.run()
    cell.assert_stays(2.0)
