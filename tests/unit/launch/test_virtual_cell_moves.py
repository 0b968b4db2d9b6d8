"""Moves in a whole cell on a virtual clock: arrival or a reason, and one commander."""

import numpy as np
import pytest

from common.motion.convert import pose_of, record_of
from forcemesh import topics
from forcemesh.messages import (
    PoseRecord,
    Speed,
)
from forcemesh.requests import MoveRequest
from tests.fakes.lab import Lab


@pytest.fixture
def lab() -> Lab:
    """An armed cell."""
    return Lab()


def test_a_pose_that_the_joints_do_not_reach_is_refused_before_the_start(lab: Lab) -> None:
    """Inside the workspace box but beyond the arm: nothing moves, the arm stays armed."""
    far = PoseRecord(position_m=(0.39, 0.79, 0.6), orientation_xyzw=lab.state.orientation_xyzw)
    reply = lab.ask(topics.MOVE, MoveRequest(kind="pose", pose=far))
    assert (reply.accepted, reply.code) == (False, "unreachable")
    assert reply.text.startswith("on the path: ")
    lab.assert_still(0.3)
    assert lab.status.state == "ARMED"
    assert not lab.status.trips


def test_the_speed_setting_scales_the_duration_of_a_move(lab: Lab) -> None:
    """The real speed is mechanical times modular: half of either is twice the time."""

    def duration_s(speed: Speed, **shift: float) -> float:
        assert lab.ask(topics.SPEED, speed).accepted
        T = pose_of(lab.state)
        T.translation = T.translation + np.array([0.0, 0.0, shift["z_m"]])
        assert lab.ask(topics.MOVE, MoveRequest(kind="pose", pose=record_of(T))).accepted
        return lab.finish_move()

    fast_s = duration_s(Speed(mechanical_m_s=0.1), z_m=0.08)
    assert fast_s == pytest.approx(0.8, abs=0.2)
    half_s = duration_s(Speed(mechanical_m_s=0.05), z_m=-0.08)
    assert half_s == pytest.approx(2.0 * fast_s, rel=0.15)
    modular_s = duration_s(Speed(mechanical_m_s=0.2, modular_fraction=0.25), z_m=0.08)
    assert modular_s == pytest.approx(half_s, rel=0.05)
