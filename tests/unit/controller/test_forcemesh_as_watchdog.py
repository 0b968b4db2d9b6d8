"""The program that ships, executed: whatever goes wrong, the arm stops, and nothing resumes."""

import numpy as np
import pytest

from controller.packet import VecInt
from controller.packet_table import ID_FIRST, Com, Status
from sim.as_language.errors import AsError
from sim.controller.behaviour import Behaviour
from tests.fakes.controller_talk import LIMITS, Talk, push

WATCHDOG_S = LIMITS[5] * 1e-3
UP_10_N: VecInt = (0, 0, 1000, 0, 0, 0)
BRAKE_S = 0.2  # from 50 mm/s to a standstill, and the watchdog's own pause


def moving(behaviour: Behaviour, limits: VecInt = LIMITS) -> Talk:
    """In motion: 30 mm up, and 30 mm more waits behind it; another one is in the ring."""
    talk = Talk(behaviour)
    talk.hello(limits=limits)
    talk.move_up(30.0)
    talk.move_up(60.0)
    talk.move_up(90.0)
    z = talk.height_mm()
    talk.wait(lambda: talk.height_mm() > z + 5.0)
    return talk


def feeding(behaviour: Behaviour, limits: VecInt = LIMITS) -> Talk:
    """Force feedback yields by 20 mm/s to a wrench that has come every 20 ms."""
    talk = Talk(behaviour)
    talk.hello(limits=limits)
    talk.start_feedback(1, gains_i=(0, 0, 10_000, 0, 0, 0))
    z = talk.height_mm()
    while talk.height_mm() < z + 3.0:
        push(talk, 1, UP_10_N)
    return talk


def standing_s(talk: Talk, limit_s: float = 4.0, *, beat: bool = False) -> float:
    """Return the time until the arm stands, for good: nothing moves in the two seconds after."""
    start_s, moved_s, q = talk.now_s, talk.now_s, talk.robot.q
    while talk.now_s < start_s + limit_s:
        talk.live(0.01, beat=beat)
        if np.abs(talk.robot.q - q).max() > 2e-5:
            moved_s = talk.now_s
        q = talk.robot.q
    assert moved_s < start_s + limit_s - 2.0, "still moving"
    return moved_s - start_s


def stays(talk: Talk, duration_s: float, *, beat: bool = False) -> bool:
    """Return whether the arm stays where it is."""
    q = talk.robot.q
    talk.live(duration_s, beat=beat)
    return bool(np.abs(talk.robot.q - q).max() < 2e-4)


# --- silence --------------------------------------------------------------------------------------


def test_force_feedback_that_waits_for_a_wrench_takes_each_hold_at_once() -> None:
    """The robot program notes that of the watchdog, and one that comes after it."""
    talk = Talk()
    talk.hello()
    talk.start_feedback(1)
    push(talk, 10, UP_10_N)
    talk.wait(lambda: talk.status & Status.WATCHDOG_LATCHED, beat=False)
    talk.send(Com.HOLD)
    talk.live(0.05)
    assert talk.value("fm.ack") == talk.value("fm.hseq") + talk.value("fm.wseq")


@pytest.mark.parametrize("limit_ms", [150, 600])
def test_silence_stops_a_motion_within_the_limit_of_command_10_and_latches(
    behaviour: Behaviour, limit_ms: int
) -> None:
    """Fault 1. The arm moves a while before it; motions behind the present one do not start."""
    talk = moving(behaviour, (*LIMITS[:5], limit_ms))
    talk.send(Com.HEARTBEAT)
    assert 0.4 * limit_ms * 1e-3 < standing_s(talk) < limit_ms * 1e-3 + BRAKE_S
    assert talk.value("fm.fault") == 1
    assert any(p.param & Status.WATCHDOG_LATCHED for p in talk.received(Com.POSE))
    assert not talk.robot.queue.is_ahead
    talk.wait(lambda: talk.closed, 3.0, beat=False)
    assert stays(talk, 0.5)
    talk.hello()
    assert talk.status & Status.HELD
    assert not talk.status & Status.WATCHDOG_LATCHED
    assert stays(talk, 0.5, beat=True)


def test_nothing_is_watched_before_something_may_move(behaviour: Behaviour) -> None:
    """After hello and settings a silence is no fault; after a hold it is none any more."""
    talk = Talk(behaviour)
    talk.hello()
    talk.live(1.5)
    assert not talk.status & Status.WATCHDOG_LATCHED
    talk.send(Com.HEARTBEAT)
    talk.live(0.1)
    talk.send(Com.HOLD)
    talk.live(1.5)
    assert not talk.status & Status.WATCHDOG_LATCHED
    assert not talk.closed
    talk.send(Com.HEARTBEAT)
    talk.wait(lambda: talk.value("fm.fault") == 1, WATCHDOG_S + 0.1, beat=False)


def test_a_new_connection_that_comes_to_the_id_of_the_last_one_is_no_silence() -> None:
    """Hello 1 and beat 2, hung up, and the same again, at any moment between two checks."""
    talk = Talk()
    for phase in range(20):
        talk.greet()
        talk.send(Com.HEARTBEAT)
        talk.live(0.08)
        assert talk.value("fm.fault") == 0
        talk.hang_up()
        talk.live(1.0 + 0.003 * phase)


# --- wrenches -------------------------------------------------------------------------------------


def test_a_gap_between_two_wrenches_is_not_made_up_for(behaviour: Behaviour) -> None:
    """After a gap that is shorter than the limit the integral counts anew: no leap."""
    talk = feeding(behaviour, (*LIMITS[:5], 600))
    talk.send(Com.GAINS, 1, (0, 0, 1_000, 0, 0, 0))
    for _ in range(10):
        push(talk, 1, UP_10_N)
    talk.live(0.3, beat=True)
    z = talk.height_mm()
    push(talk, 1, UP_10_N)
    push(talk, 1, UP_10_N)
    talk.live(0.05, beat=True)
    assert talk.status & Status.POSITION_FEEDBACK
    assert talk.height_mm() - z < 0.15  # 40 ms of 2 mm/s are 0.08 mm; 300 ms more would be 0.68 mm


# --- a peer that does not read --------------------------------------------------------------------


def test_a_peer_that_does_not_read_is_dropped_and_the_next_one_served(behaviour: Behaviour) -> None:
    """The sender hangs; beats still come, so it is no silence; still the connection ends."""
    talk = Talk(behaviour)
    talk.hello()
    talk.reading = False
    talk.send(Com.HEARTBEAT)
    talk.wait(lambda: talk.stream.partner is None or talk.stream.partner.closed, 15.0)
    talk.hang_up()
    talk.reading = True
    talk.hello()
    assert talk.status & Status.HELD
    assert stays(talk, 0.5)


# --- the pendant ----------------------------------------------------------------------------------


def test_an_error_stop_is_latched_and_needs_ereset_and_execute(behaviour: Behaviour) -> None:
    """103 reports AS's own code; hello is answered; no packet moves the arm before EXECUTE."""
    talk = moving(behaviour)
    talk.machine.control.failed(talk.machine.robot_task, AsError("E6007"))
    assert standing_s(talk, 3.0, beat=True) < BRAKE_S
    assert talk.value("fm.fault") == 3
    talk.hello(limits=None)
    assert talk.fault == -36007
    assert talk.status & Status.ERROR
    assert not talk.status & Status.PROGRAM_RUNNING
    talk.send(Com.MOVE_POSE, 0, talk.shifted_vec(z=10.0))
    assert stays(talk, 1.0, beat=True)
    assert talk.taken == ID_FIRST  # the hello itself
    talk.pendant.error_reset()
    talk.pendant.execute("fm.main")
    assert stays(talk, 2.0)  # a controller that plans its first motion for a second listens anew
    talk.hello()
    assert talk.status & Status.PROGRAM_RUNNING
    assert not talk.status & Status.ERROR
    z = talk.height_mm()
    talk.move_up(10.0)
    talk.wait(lambda: talk.height_mm() > z + 9.9)


# --- errors that stand ----------------------------------------------------------------------------


def pull_the_cable(talk: Talk) -> None:
    """Break the connection during a motion; the error is reset while the arm stands."""
    talk.hello()
    z, before = talk.height_mm(), talk.value("fm.eres")
    talk.move_up(20.0)
    talk.wait(lambda: talk.height_mm() > z + 2.0)
    talk.stream.reset()
    assert standing_s(talk) < WATCHDOG_S + BRAKE_S + 0.5
    talk.wait(lambda: talk.value("fm.eresu") == before + 1, beat=False)
    assert talk.value("fm.fault") == 19
    assert talk.machine.control.error is None
    assert talk.height_mm() < z + 20.0


@pytest.mark.parametrize("stops_robot", [False, True])
def test_after_each_pulled_cable_the_link_returns_without_the_pendant(
    behaviour: Behaviour, stops_robot: bool
) -> None:
    """Also where a broken connection is a standing error, and where that stops every program."""
    standing = {"tcp_error_stands": True, "pc_error_stops_robot": stops_robot}
    talk = Talk(behaviour.model_copy(update=standing))
    for pulled in range(1, 6):
        pull_the_cable(talk)
        assert talk.value("fm.eresu") == pulled


def test_an_error_of_the_program_stays_the_pendants(behaviour: Behaviour) -> None:
    """Only errors of the connection are reset, though the arm is held."""
    talk = Talk(behaviour.model_copy(update={"pc_error_stops_robot": False}))
    talk.hello()
    sender = talk.machine.tasks[1]
    talk.machine.control.failed(sender, AsError("E0108"))
    talk.live(2.0, beat=True)
    assert talk.value("fm.eres") == 0
    assert talk.status & Status.ERROR
    assert str(talk.machine.control.error).startswith("(E0108)")
