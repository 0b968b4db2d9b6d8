"""Command 15 and report 104, executed by the program that ships: outputs set, signals reported."""

import pytest

from controller.packet import ZERO_VEC, VecInt
from controller.packet_table import Com, SignalParam, Status
from sim.controller.behaviour import Behaviour
from tests.fakes.controller_talk import Talk

GROUPS: VecInt = (1, 1001, 0, 0, 0, 0)


def switch(talk: Talk, number: int) -> None:
    """Switch an output and wait until the receiver has done it."""
    sent = talk.send(Com.SIGNAL, SignalParam.SWITCH, (number, 0, 0, 0, 0, 0))
    talk.wait(lambda: talk.framed >= sent)


def choose(talk: Talk, groups: VecInt = GROUPS) -> int:
    """Choose the groups that are reported; return the ID of the command."""
    sent = talk.send(Com.SIGNAL, SignalParam.GROUPS, groups)
    talk.wait(lambda: talk.framed >= sent)
    return sent


def reported(talk: Talk) -> VecInt:
    """Return the groups of the next two reports, of which the second is new."""
    count = len(talk.received(Com.SIGNALS))
    talk.wait(lambda: len(talk.received(Com.SIGNALS)) > count + 1)
    return talk.last(Com.SIGNALS).vec


def test_an_output_is_switched_at_once_in_a_motion_and_in_a_hold(behaviour: Behaviour) -> None:
    """On and off, the neighbours stay; the ring of commands has no part, and the motion goes on."""
    talk = Talk(behaviour)
    talk.hello()
    signals = talk.machine.hardware.signals
    talk.move_up(60.0)
    talk.wait(lambda: talk.status & Status.MOVING)
    switch(talk, 9)
    assert [signals.holds(number) for number in (8, 9, 10)] == [False, True, False]
    switch(talk, 960)
    assert signals.holds(960)
    assert talk.status & Status.MOVING
    talk.send(Com.HOLD)
    switch(talk, -9)
    assert not signals.holds(9)
    assert talk.status & Status.HELD


def test_the_command_arms_nothing() -> None:
    """Silence after it is no fault: it moves nothing."""
    talk = Talk()
    talk.hello(limits=None)
    switch(talk, 1)
    talk.live(1.0)
    assert not talk.closed
    assert not talk.status & Status.WATCHDOG_LATCHED


def test_no_signals_are_reported_before_groups_are_chosen() -> None:
    """A PC whose cell file names none receives no 104, also after a connection that had them."""
    talk = Talk()
    talk.hello()
    talk.live(1.0, beat=True)
    assert not talk.received(Com.SIGNALS)
    choose(talk)
    reported(talk)
    talk.hang_up()
    talk.hello()
    talk.live(1.0, beat=True)
    assert not talk.received(Com.SIGNALS)


def test_the_chosen_groups_are_reported(behaviour: Behaviour) -> None:
    """The first signal of a group is bit 0; a group of number 0 is 0."""
    talk = Talk(behaviour)
    talk.hello()
    sent = choose(talk, (1, 1001, 945, 1945, 0, 17))
    signals = talk.machine.hardware.signals
    for number in (1, 16, 1002, 960, 1945, 18):
        signals.set(number)
    assert reported(talk) == (0x8001, 0x2, 0x8000, 0x1, 0, 0x2)
    assert all(packet.id >= sent for packet in talk.received(Com.SIGNALS)[2:])


@pytest.mark.parametrize(
    ("param", "vec"),
    [
        (SignalParam.SWITCH, (0, 0, 0, 0, 0, 0)),
        (SignalParam.SWITCH, (961, 0, 0, 0, 0, 0)),
        (SignalParam.SWITCH, (-961, 0, 0, 0, 0, 0)),
        (SignalParam.SWITCH, (1001, 0, 0, 0, 0, 0)),
        (SignalParam.GROUPS, (946, 0, 0, 0, 0, 0)),
        (SignalParam.GROUPS, (1, 1000, 0, 0, 0, 0)),
        (SignalParam.GROUPS, (1, 1001, 0, 0, 0, 1946)),
        (SignalParam.GROUPS, (-1, 0, 0, 0, 0, 0)),
        (2, ZERO_VEC),
    ],
)
def test_a_number_that_is_no_signal_ends_the_connection(param: int, vec: VecInt) -> None:
    """The gateway never sends one; none reaches SIGNAL or BITS, whose error would end a task."""
    talk = Talk()
    talk.hello()
    talk.send(Com.SIGNAL, param, vec)
    talk.wait(lambda: talk.closed, beat=False)
    assert talk.value("fm.fault") == 4
    assert talk.machine.control.error is None
