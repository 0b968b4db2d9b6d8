"""Back-off behind the arbiter: every robot accepts that goal alone and monitors the force."""

import numpy as np
import pinocchio as pin
import pytest

from common.motion.back_off import SPEED_M_S
from forcemesh.messages import Permission, Speed, WrenchAtTcp
from tests.contract.rig import Rig, pose_goal, shifted

SLOW = Speed(mechanical_m_s=SPEED_M_S)
UP_N = 75.0


def begin(rig: Rig, force_N: float = UP_N) -> pin.SE3:
    """Open a back-off lease while a force pushes the tool upwards; return the reported pose."""
    push(rig, force_N)
    rig.arm(purpose="back_off")
    assert rig.is_at_rest()
    return pin.SE3(rig.T)


def push(rig: Rig, force_N: float) -> None:
    """Apply an upward force of the environment and publish it as a calibrated wrench."""
    rig.wrench = WrenchAtTcp(calibrated=True, force_N=(0.0, 0.0, force_N))


def permission(rig: Rig) -> Permission:
    """Return a permission to back off."""
    return rig.permission(purpose="back_off")


def send_goal(rig: Rig, number: int, T: pin.SE3, speed: Speed = SLOW) -> None:
    """Send a goal under the back-off permission."""
    rig.send("goal", goal=pose_goal(number, T), speed=speed, permission=permission(rig))


def refused_as(rig: Rig, number: int) -> None:
    """Wait until the robot has refused the goal of this number."""
    rig.until(lambda: rig.state.goal.id == number and rig.state.goal.state == "refused")


def up_m(rig: Rig, start: pin.SE3) -> float:
    """Return the upward travel of the flange."""
    return float(rig.T.translation[2] - start.translation[2])


def test_above_its_ceiling_a_robot_backs_off_and_does_nothing_else(guarded_rig: Rig) -> None:
    """75 N push up, the ceiling is 60: down, aside and fast are refused; up and slowly is done."""
    rig = guarded_rig
    start = begin(rig)
    wrong = [
        (shifted(start, z_m=-0.004), SLOW),
        (shifted(start, x_m=0.004), SLOW),
        (shifted(start, z_m=0.004), Speed(mechanical_m_s=0.02)),
    ]
    for number, (T, speed) in enumerate(wrong, start=1):
        send_goal(rig, number, T, speed)
        refused_as(rig, number)
        assert np.linalg.norm(rig.T.translation - start.translation) < 3e-4
    send_goal(rig, 9, shifted(start, z_m=0.004))
    rig.until(lambda: rig.state.goal.id == 9 and rig.state.goal.state == "done")
    assert up_m(rig, start) == pytest.approx(0.004, abs=5e-4)
