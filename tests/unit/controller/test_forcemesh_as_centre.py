"""The program that ships, executed: the point that force feedback turns about may move."""

import numpy as np
import pinocchio as pin
import pytest

from common.motion.frames import rotation_between
from controller.packet_table import CentreParam, Com, Status
from tests.fakes.controller_talk import Talk, push

AT_TCP = (0, 0, 8000, 0, 0, 0)
TURN_X = (0, 0, 0, 1000, 0, 0)


def turning(mode: int = 2) -> Talk:
    """Force feedback that turns about base x at 2 degrees a second for each N m."""
    talk = Talk()
    talk.hello()
    talk.send(Com.TCP, CentreParam.CENTRE, AT_TCP)
    talk.start_feedback(mode, gains_i=(0, 0, 1000, 10_000, 0, 0))
    push(talk, 2)
    return talk


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
    talk = turning(mode)
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
    tcp_mm, rim_mm = np.array([0.0, 0.0, 160.0]), np.array([0.0, 25.0, 160.0])
    talk = turning()
    push(talk, 5, TURN_X)
    assert farthest_travel(talk, tcp_mm) < 0.05
    talk.do(Com.TCP, CentreParam.CENTRE, (0, 1250, 8000, 0, 0, 0))
    assert farthest_travel(talk, rim_mm) < 0.05
    talk.do(Com.TCP, CentreParam.CENTRE, AT_TCP)
    assert farthest_travel(talk, tcp_mm) < 0.05


def test_travel_counts_on_from_the_start() -> None:
    """A centre that moves does not give back used travel: 3 mm of travel, fault 6."""
    talk = Talk()
    talk.hello(limits=(50, 1000, 500, 150, 5_000, 250))
    talk.send(Com.TCP, CentreParam.CENTRE, AT_TCP)
    talk.start_feedback(3, gains_i=(0, 0, 2500, 0, 0, 0))
    push(talk, 2)
    z = talk.height_mm()
    for turn in range(20):
        push(talk, 2, (0, 0, 1000, 0, 0, 0))
        talk.send(Com.TCP, CentreParam.CENTRE, (0, 50 * turn, 8000, 0, 0, 0))
    assert talk.fault == 6
    assert talk.height_mm() - z < 3.3
