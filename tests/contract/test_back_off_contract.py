"""Backing off, behind the arbiter: every robot takes that one goal alone, and watches the force."""

import numpy as np
import pinocchio as pin
import pytest

from common.motion.back_off import SPEED_M_S
from forcemesh.messages import Permission, Speed, WrenchAtTcp
from tests.contract.rig import DEADLINE_S, Rig, pose_goal, shifted

SLOW = Speed(mechanical_m_s=SPEED_M_S)
UP_N = 75.0


def begin(rig: Rig, force_N: float = UP_N) -> pin.SE3:
    """Open a lease to back off while something pushes the tool upwards; return where the arm is."""
    push(rig, force_N)
    rig.lease += 1
    rig.say("idle", permission=permission(rig))
    rig.until(lambda: rig.state.valid and not rig.state.hold_reason)
    assert rig.is_at_rest()
    return pin.SE3(rig.T)


def push(rig: Rig, force_N: float) -> None:
    """Let the environment push up, as a calibrated wrench says it."""
    rig.wrench = WrenchAtTcp(calibrated=True, force_N=(0.0, 0.0, force_N))


def permission(rig: Rig) -> Permission:
    """Return leave to back off."""
    return Permission(host="pc", lease=rig.lease, deadline_s=DEADLINE_S, purpose="back_off")


def go(rig: Rig, number: int, T: pin.SE3, speed: Speed = SLOW) -> None:
    """Ask for a goal under it."""
    rig.say("goal", goal=pose_goal(number, T), speed=speed, permission=permission(rig))


def refused_as(rig: Rig, number: int) -> None:
    """Wait until the robot has refused the goal of this number."""
    rig.until(lambda: rig.state.goal.id == number and rig.state.goal.state == "refused")


def up_m(rig: Rig, start: pin.SE3) -> float:
    """Return how far the flange went up."""
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
        go(rig, number, T, speed)
        refused_as(rig, number)
        assert np.linalg.norm(rig.T.translation - start.translation) < 3e-4
    go(rig, 9, shifted(start, z_m=0.004))
    rig.until(lambda: rig.state.goal.id == 9 and rig.state.goal.state == "done")
    assert up_m(rig, start) == pytest.approx(0.004, abs=5e-4)


def test_a_force_that_rises_stops_it(guarded_rig: Rig) -> None:
    """By 5 N above the least so far, though that is far below the ceiling."""
    rig = guarded_rig
    start = begin(rig)
    go(rig, 1, shifted(start, z_m=0.015))
    rig.until(lambda: up_m(rig, start) > 0.001)
    push(rig, 40.0)
    rig.advance(0.1)
    assert rig.state.hold_reason == ""
    push(rig, 45.0)
    rig.until(lambda: "force rose" in rig.state.hold_reason, within_s=1.0)
    assert rig.is_at_rest()
    assert up_m(rig, start) < 0.012
