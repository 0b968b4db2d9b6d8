"""Signals of the controller in the gateway: command 15 out, report 104 in, unknown when lost."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.signals import GROUP, INPUTS, OUTPUTS, SignalSection
from controller.packet import Packet, encode
from controller.packet_table import Com
from forcemesh.clock import NS_PER_S
from forcemesh.errors import RemoteProtocolError
from services.gateway.connection import ControllerConnection
from services.gateway.packets import SignalReport, parse_report
from services.gateway.signals import STALE_AFTER_S, ControllerSignals, switch_output
from tests.fakes.dialogues import KEPT, SCALES, joint_report, last_id, packets, pose_report
from tests.unit.services.gateway.test_connection import FIT, STALE_S, ConnectionRig

NAMED = {"close": SignalSection(output=9), "part": SignalSection(input=1001)}


class SignalRig(ConnectionRig):
    """A connection of a cell with two signals, greeted and set up."""

    def __init__(self) -> None:
        """Greet; the receiver has framed everything."""
        super().__init__()
        self.connection = ControllerConnection(
            self.wire, self.dialogue, KEPT, stale_after_s=STALE_S,
            signals=ControllerSignals(NAMED),
        )  # fmt: skip
        self.greet()
        self.sent = packets(self.wire.sent)
        self.report_all()

    def report_all(self) -> None:
        """Receive a pose, which shows that all was executed."""
        id_ = last_id(self.dialogue)
        self.receive(pose_report(id_, FIT) + joint_report(id_))

    def signals(self, vec: tuple[int, ...] = (0x100, 1, 0, 0, 0, 0), *, before: int = 0) -> None:
        """Receive 104, with the ID of the last packet or of one before it."""
        id_ = last_id(self.dialogue) - before
        self.receive(encode(Packet(id_, Com.SIGNALS, 0, vec)))  # type: ignore[arg-type]


@pytest.fixture
def rig() -> SignalRig:
    """A connection with signals."""
    return SignalRig()


@pytest.mark.parametrize(("on", "number"), [(True, 9), (False, -9)])
def test_an_output_is_switched_by_its_number_alone(on: bool, number: int) -> None:
    """Negative for off; the other numbers of the packet are zero."""
    assert switch_output(9, on=on).vec == (number, 0, 0, 0, 0, 0)


@given(st.data())
def test_every_chosen_signal_returns_from_its_group(data: st.DataObject) -> None:
    """What the controller would pack by BITS is what the reading has, for any choice."""
    chosen = data.draw(st.sets(st.sampled_from([*OUTPUTS[:48], *INPUTS[:48]]), min_size=1))
    on = data.draw(st.sets(st.sampled_from(sorted(chosen))))
    sections = {
        f"s{n}": SignalSection(output=n) if n in OUTPUTS else SignalSection(input=n) for n in chosen
    }
    signals = ControllerSignals(sections)
    (choice,) = signals.selection
    packed = [
        sum((first + k in on) << k for k in range(GROUP)) if first else 0 for first in choice.vec
    ]
    a, b, c, d, e, f = packed
    signals.take(SignalReport((a, b, c, d, e, f), 500_000), 0)
    reading = signals.reading(0)
    assert {number for number in chosen if reading.on[number]} == on
    signals.disconnected()
    assert signals.reading(0).code == "robot_link"


def test_a_cell_without_signals_chooses_none() -> None:
    """Its connection has no packet more than before."""
    assert ControllerSignals({}).selection == ()
    plain = ConnectionRig().greet()
    assert Com.SIGNAL not in {packet.com for packet in packets(plain.wire.sent)}
    plain.receive(encode(Packet(last_id(plain.dialogue), Com.SIGNALS, 0)))
    assert plain.connection.dialogue.ready


def test_the_groups_are_chosen_after_hello(rig: SignalRig) -> None:
    """Once, after the limits."""
    chosen = [packet for packet in rig.sent if packet.com == Com.SIGNAL]
    assert [(each.param, each.vec) for each in chosen] == [(1, (1, 1001, 0, 0, 0, 0))]
    assert rig.sent[-1] == chosen[0]


def test_a_report_from_before_the_choice_is_ignored(rig: SignalRig) -> None:
    """It is of the groups of another connection."""
    rig.signals(before=1)
    assert rig.connection.signals(rig.now_ns).code == "robot_link"


def test_a_lost_link_makes_the_state_unknown(rig: SignalRig) -> None:
    """At once, and after the next hello until the next report."""
    assert rig.connection.signals(rig.now_ns).code == "robot_link"
    rig.signals()
    assert [rig.connection.signals(rig.now_ns).on[n] for n in (9, 10, 1001)] == [True, False, True]
    rig.receive(lost="cut by the test")
    rig.wire.sent = b""
    assert rig.connection.signals(rig.now_ns).code == "robot_link"
    rig.greet()
    rig.report_all()
    assert "not reported" in rig.connection.signals(rig.now_ns).reason
    rig.signals()
    assert not rig.connection.signals(rig.now_ns).code


def test_an_old_report_makes_the_state_unknown(rig: SignalRig) -> None:
    """Also when poses are still received."""
    rig.signals()
    rig.now_ns += round((STALE_AFTER_S + 0.1) * NS_PER_S)
    rig.report_all()
    assert "2.1 s old" in rig.connection.signals(rig.now_ns).reason


def test_outputs_are_switched_one_at_a_time(rig: SignalRig) -> None:
    """The next one waits until the receiver has executed the one before."""
    rig.signals()
    rig.wire.sent = b""
    assert rig.connection.switch(9, on=True, now_ns=rig.now_ns) is None
    busy = rig.connection.switch(9, on=False, now_ns=rig.now_ns)
    assert busy is not None
    assert busy.code == "wait"
    rig.report_all()
    assert rig.connection.switch(9, on=False, now_ns=rig.now_ns) is None
    assert [packet.vec[0] for packet in packets(rig.wire.sent)] == [9, -9]


@pytest.mark.parametrize("group", [-1, 1 << 16])
def test_a_number_that_is_no_group_ends_the_connection(group: int) -> None:
    """16 signals are 0 to 65535."""
    packet = Packet(500_000, Com.SIGNALS, 0, (0, 0, group, 0, 0, 0))
    with pytest.raises(RemoteProtocolError, match=f"104 has {group} for a group"):
        parse_report(packet, SCALES)
