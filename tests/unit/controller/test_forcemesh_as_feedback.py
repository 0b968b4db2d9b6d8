"""The program that ships, executed: force feedback inside the controller."""

import numpy as np
import pinocchio as pin
import pytest

from common.motion.frames import rotation_between
from controller.packet import VecInt
from controller.packet_table import CentreParam, Com, Status
from sim.controller.behaviour import Behaviour, pessimistic
from tests.fakes.controller_talk import LIMITS, QUICK, Talk, push

TCP_MM = np.array([0.0, 0.0, 160.0])
AT_TCP: VecInt = (0, 0, 8000, 0, 0, 0)
TURN_X: VecInt = (0, 0, 0, 1000, 0, 0)


def running(
    mode: int,
    *,
    gains_p: VecInt = (0,) * 6,
    gains_i: VecInt = (0,) * 6,
    limits: VecInt = LIMITS,
    behaviour: Behaviour = QUICK,
) -> Talk:
    """Force feedback runs, about a TCP 160 mm below the flange, with one zero wrench received."""
    talk = Talk(behaviour)
    talk.hello(limits=limits)
    talk.send(Com.TCP, CentreParam.CENTRE, AT_TCP)
    talk.start_feedback(mode, gains_p=gains_p, gains_i=gains_i)
    push(talk, 2)
    return talk


def tcp_mm(T: pin.SE3) -> np.ndarray:
    """Return the position of the TCP."""
    return np.array(T.act(TCP_MM))


# --- the law --------------------------------------------------------------------------------------


def test_a_long_turn_about_a_slanted_axis_stays_about_that_axis() -> None:
    """Rotations are composed: 20 degrees about (1, 1, 1) and back end where they began."""
    talk = running(2, gains_i=(0, 0, 0, 20_000, 20_000, 20_000))
    start = talk.T_mm
    push(talk, 170, (0, 0, 0, 1700, 1700, 1700))
    turned = np.degrees(rotation_between(start.rotation, talk.T_mm.rotation))
    assert np.linalg.norm(turned) > 20.0
    assert np.allclose(turned / np.linalg.norm(turned), np.ones(3) / 3**0.5, atol=0.01)
    assert np.allclose(tcp_mm(talk.T_mm), tcp_mm(start), atol=0.05)
    push(talk, 170, (0, 0, 0, -1700, -1700, -1700))
    push(talk, 10)
    left = np.degrees(rotation_between(start.rotation, talk.T_mm.rotation))
    assert (
        np.linalg.norm(left) < 1.0
    )  # four iterations of 0.24 degrees, of 340; which ones is chance


@pytest.mark.parametrize(
    "behaviour", [Behaviour(step_s=4e-4), pessimistic(QUICK.step_s)], ids=["slow", "pessimistic"]
)
def test_the_law_does_not_depend_on_the_speed_of_the_controller(behaviour: Behaviour) -> None:
    """The integral goes over the time that passed, coarse as TIMER may be."""
    talk = running(1, gains_i=(0, 0, 1000, 0, 0, 0), behaviour=behaviour)
    for _ in range(5):
        talk.send(Com.WRENCH, 0, (0, 0, 1000, 0, 0, 0))
        talk.live(0.1)
    z = talk.height_mm()
    for _ in range(20):
        talk.send(Com.WRENCH, 0, (0, 0, 1000, 0, 0, 0))
        talk.live(0.1)
    assert talk.height_mm() - z == pytest.approx(4.0, abs=0.3)


# --- limits ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_an_iteration_goes_no_farther_than_step_and_speed_allow(mode: int) -> None:
    """A gain that is far too high is a slow ramp of the flange, not a jump.

    The limit is the flange's: 160 mm above the TCP it has its own travel when it turns.
    """
    limits = (10, 100, 50, 10_000, 5_000, 250)  # 0.2 mm, 0.2 degrees, 5 mm/s
    vec = (0, 0, 3000 * (mode & 1), 3000 * (mode >> 1), 0, 0)
    talk = running(mode, gains_i=(450_000,) * 6, limits=limits)
    push(talk, 3, vec)
    start = talk.T_mm
    push(talk, 25, vec)
    travel = float(np.linalg.norm(talk.T_mm.translation - start.translation))
    assert 1.2 < travel < 2.6  # 0.5 s at 5 mm/s
    turned = np.degrees(np.linalg.norm(rotation_between(start.rotation, talk.T_mm.rotation)))
    assert turned < 0.5 * 5.0 / 1.75 * 1.1
    assert (turned > 0.3) == (mode > 1)
    risen = float(tcp_mm(talk.T_mm)[2] - tcp_mm(start)[2])
    assert (risen > 0.5) == (mode != 2)


# --- start and stop -------------------------------------------------------------------------------


def test_motions_are_refused_while_it_runs() -> None:
    """Two masters of one arm are none."""
    talk = running(1)
    before = talk.robot.q.copy()
    for com in (Com.MOVE_POSE, Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS):
        sent = talk.send(com, 0, (50, 0, 0, 0, 0, 0))
        push(talk, 5)
        assert talk.taken == sent
        assert talk.status & Status.TARGET_REFUSED
    assert np.allclose(talk.robot.q, before, atol=1e-4)
    assert talk.status & Status.POSITION_FEEDBACK


def test_stop_ends_both_and_the_arm_may_move_again() -> None:
    """Without a hold: HELD does not show."""
    talk = running(3, gains_i=(0, 0, 1000, 0, 0, 0))
    push(talk, 10, (0, 0, 1000, 0, 0, 0))
    talk.send(Com.FEEDBACK, 2)
    talk.live(0.2, beat=True)
    assert not int(talk.status) >> 5 & 3
    assert not talk.status & Status.HELD
    before = talk.robot.q.copy()
    push(talk, 10, (0, 0, 1000, 0, 0, 0))
    assert np.allclose(talk.robot.q, before, atol=1e-4)
    z = talk.height_mm()
    talk.move_up(5.0)
    talk.live(1.0, beat=True)
    assert talk.height_mm() - z == pytest.approx(5.0, abs=0.1)


def test_a_stop_voids_a_start_that_still_waits() -> None:
    """The receiver does the stop at once, the robot program the start later: stop wins."""
    talk = Talk()
    talk.hello()
    talk.move_up(60.0, speed_mm_s=50.0)
    talk.move_up(-60.0, speed_mm_s=50.0)  # the robot program waits to hand this over
    talk.send(Com.FEEDBACK, 0)
    talk.send(Com.FEEDBACK, 2)
    talk.live(4.0, beat=True)
    assert not int(talk.status) >> 5 & 3


def test_a_hold_ends_it_and_a_new_start_begins_where_the_arm_is() -> None:
    """Displacement and rotation count from the new start; nothing jumps back."""
    talk = running(3, gains_i=(0, 0, 1000, 10_000, 0, 0))
    push(talk, 50, (0, 0, 1000, 1000, 0, 0))
    talk.send(Com.HOLD)
    talk.live(0.6)
    assert not int(talk.status) >> 5 & 3
    start = talk.T_mm
    talk.start_feedback(3, gains_i=(0, 0, 1000, 10_000, 0, 0))
    push(talk, 10)
    assert np.allclose(talk.T_mm.homogeneous, start.homogeneous, atol=0.02)


# --- the point that it turns about ----------------------------------------------------------------


def farthest_travel(talk: Talk, point_mm: np.ndarray, times: int = 50) -> float:
    """Turn, and return how far a point of the flange frame went at most [mm]."""
    start: pin.SE3 = talk.T_mm
    farthest = 0.0
    for _ in range(times):
        push(talk, 1, TURN_X)
        travel = talk.T_mm.act(point_mm) - start.act(point_mm)
        farthest = max(farthest, float(np.linalg.norm(travel)))
    turned = np.degrees(rotation_between(start.rotation, talk.T_mm.rotation))
    assert turned[0] == pytest.approx(0.04 * times, rel=0.1)
    return farthest


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_a_new_centre_moves_nothing(mode: int) -> None:
    """In the middle of a turn and of a displacement: the arm stays where it is."""
    talk = running(mode, gains_i=(0, 0, 1000, 10_000, 0, 0))
    push(talk, 25, (0, 0, 1000, 1000, 0, 0))
    push(talk, 10)
    before = talk.T_mm
    sent = talk.send(Com.TCP, CentreParam.CENTRE, (1250, -500, 8300, 0, 0, 0))
    push(talk, 10)
    assert talk.taken == sent
    assert not talk.status & Status.TARGET_REFUSED
    assert np.allclose(talk.T_mm.homogeneous, before.homogeneous, atol=2e-3)


def test_it_turns_about_the_newest_centre() -> None:
    """First the TCP stays, then a point 25 mm off it; and again the TCP."""
    talk = running(2, gains_i=(0, 0, 1000, 10_000, 0, 0))
    push(talk, 5, TURN_X)
    assert farthest_travel(talk, TCP_MM) < 0.05
    talk.do(Com.TCP, CentreParam.CENTRE, (0, 1250, 8000, 0, 0, 0))
    assert farthest_travel(talk, np.array([0.0, 25.0, 160.0])) < 0.05
    talk.do(Com.TCP, CentreParam.CENTRE, AT_TCP)
    assert farthest_travel(talk, TCP_MM) < 0.05


def test_travel_counts_on_from_the_start() -> None:
    """A centre that moves does not give back used travel: 3 mm of travel, fault 6."""
    talk = running(3, gains_i=(0, 0, 2500, 0, 0, 0), limits=(50, 1000, 500, 150, 5_000, 250))
    z = talk.height_mm()
    for turn in range(20):
        push(talk, 2, (0, 0, 1000, 0, 0, 0))
        talk.send(Com.TCP, CentreParam.CENTRE, (0, 50 * turn, 8000, 0, 0, 0))
    assert talk.fault == 6
    assert talk.height_mm() - z < 3.3
