"""Refusals of every robot, and the properties of single robots that `robots.py` states."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.motion.back_off import SPEED_M_S
from common.motion.convert import record_of
from forcemesh.messages import Feedback, Gains, Goal, Speed, WrenchAtTcp
from tests.contract.conftest import made
from tests.contract.rig import Rig, distance_m, goal, pose_goal, shifted
from tests.contract.robots import ALL, ROBOTS, Emulated

# The tool reaches back into the workspace; the wrist would be 1.1 m away from the shoulder.
FAR_AWAY = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.array([0.0, 0.93, 0.5]))
OUT_OF_REACH: dict[str, Goal] = {
    "pose": pose_goal(5, FAR_AWAY),
    "joints": goal(5, "joints", joint_rad=(0.0, 3.0, 0.0, 0.0, 0.0, 0.0)),
    "by": goal(5, "by", joint_rad=(0.0, 0.0, -1.3, 0.0, 0.0, 0.0)),
}

TIME_ENOUGH_NS = 250_000_000


@pytest.mark.parametrize("kind", OUT_OF_REACH)
def test_a_goal_out_of_reach_is_refused_and_moves_nothing(rig: Rig, kind: str) -> None:
    """Refused with a reason, under its id, without a hold; the next goal is done."""
    rig.arm()
    before = rig.T
    rig.send("goal", goal=OUT_OF_REACH[kind])
    rig.until(lambda: rig.state.goal.id == 5 and rig.state.goal.state == "refused")
    rig.advance(0.2)
    assert rig.state.goal.reason
    assert rig.state.hold_reason == ""
    assert distance_m(rig.T, before) < 1e-4
    rig.send("goal", goal=pose_goal(6, shifted(before, z_m=0.005)))
    rig.until(lambda: rig.state.goal.id == 6 and rig.state.goal.state == "done")


@pytest.mark.parametrize("kind", ["pose", "joints", "by"])
@pytest.mark.parametrize("name", ROBOTS)
def test_no_goal_is_faster_than_mechanical_times_modular_speed(name: str, kind: str) -> None:
    """Specification e), on `robot/state`: in no window of 0.3 s the flange is faster."""
    rig = made(name)
    fastest_m_s = fastest_of_goal(rig, kind)
    assert rig.state.goal.state == "done"
    assert 0.3 * 0.04 < fastest_m_s < 1.1 * 0.04


def fastest_of_goal(rig: Rig, kind: str) -> float:
    """Run a goal at half of 80 mm/s; return the flange's highest speed."""
    rig.arm()
    start, turn = rig.T, np.array([0.08, -0.04, 0.05, 0.0, 0.0, 0.0])
    goals = {
        "pose": pose_goal(1, shifted(start, x_m=0.03, z_m=0.02)),
        "joints": goal(1, "joints", joint_rad=tuple((rig.joint_rad + turn).tolist())),
        "by": goal(1, "by", joint_rad=tuple(turn.tolist())),
    }
    rig.track.clear()
    rig.send("goal", goal=goals[kind], speed=Speed(mechanical_m_s=0.08, modular_fraction=0.5))
    rig.until(lambda: rig.state.goal.state == "done")
    return rig.fastest(0.3)[0] / 0.3


# --- properties of the table ----------------------------------------------------------------------


def test_a_robot_without_a_controller_refuses_its_force_feedback(bare_rig: Rig) -> None:
    """Also under a permission that names the controller: it holds and reports the reason."""
    rig = bare_rig
    rig.arm()
    before = rig.T
    rig.wrench = WrenchAtTcp(force_N=(0.0, 0.0, 10.0))
    feedback = Feedback(mode="position", gains=Gains(force_i_m_per_Ns=(1e-3,) * 3))
    rig.send("feedback", host="controller", feedback=feedback)
    rig.until(lambda: rig.state.hold_reason)
    rig.advance(0.2)
    assert "controller" in rig.state.hold_reason
    assert distance_m(rig.T, before) < 1e-4


@pytest.mark.parametrize("rule", ["workspace", "speed"])
@pytest.mark.parametrize("name", ALL)
def test_a_goal_beyond_the_limits_of_the_cell_is_refused(name: str, rule: str) -> None:
    """The robot refuses a goal outside the limits of the cell by itself, and names the rule."""
    rig = made(name)
    rig.arm()
    before, limits = rig.T, rig.cell.limits
    height_m = limits.workspace_max_m[2] - rig.T_tcp.translation[2]
    if rule == "workspace":
        rig.send("goal", goal=pose_goal(1, shifted(before, z_m=height_m + 0.01)))
    else:
        speed = Speed(mechanical_m_s=1.2 * limits.speed_m_s)
        rig.send("goal", goal=pose_goal(1, shifted(before, z_m=0.01)), speed=speed)
    rig.until(lambda: rig.state.goal.state == "refused")
    rig.advance(0.2)
    assert rule in rig.state.goal.reason
    assert distance_m(rig.T, before) < 1e-4


def test_set_points_that_run_faster_than_the_cell_allows_end_in_hold(guarded_rig: Rig) -> None:
    """Twice the speed limit, in small steps: the arm stops, and it was never faster."""
    rig = guarded_rig
    rig.arm()
    start, limit_m_s = rig.T, rig.cell.limits.speed_m_s
    rig.track.clear()
    rig.send("setpoint", pose=record_of(start))
    rig.advance(0.05)
    began_ns = rig.clock.now_ns()
    while not rig.state.hold_reason and rig.clock.now_ns() < began_ns + TIME_ENOUGH_NS:
        # By the clock, not by the count: a late machine must not make them slower.
        elapsed_s = (rig.clock.now_ns() - began_ns) * 1e-9
        rig.send("setpoint", pose=record_of(shifted(start, z_m=2.0 * limit_m_s * elapsed_s)))
        rig.advance(0.004)
    rig.advance(0.2)
    assert "set point" in rig.state.hold_reason
    assert rig.is_at_rest()
    assert distance_m(rig.T, start) < 0.05
    assert rig.fastest(0.1)[0] / 0.1 < 1.35 * limit_m_s


def test_a_command_that_fits_no_packet_holds_with_the_reason() -> None:
    """Nothing is clipped: 99 units per millimetre reach no further than 1010 mm."""
    wide: dict[str, Any] = {"limits.workspace_min_m": [-2.0] * 3, "limits.tether_m": 5.0}
    wide["gateway.position_per_mm"] = 99
    rig = Emulated(**wide).rig
    rig.connect()
    rig.arm()
    before = rig.T
    rig.send("goal", goal=pose_goal(1, shifted(before, x_m=-1.5)))
    rig.until(lambda: rig.state.hold_code == "unsendable")
    assert "the packet holds -1010.09" in rig.state.hold_reason
    assert distance_m(rig.T, before) < 1e-4


def test_above_its_ceiling_a_robot_backs_off_and_does_nothing_else(guarded_rig: Rig) -> None:
    """75 N push up, the ceiling is 60: down, aside and fast are refused; up and slowly is done."""
    rig, slow = guarded_rig, Speed(mechanical_m_s=SPEED_M_S)
    rig.wrench = WrenchAtTcp(calibrated=True, axes_checked=True, force_N=(0.0, 0.0, 75.0))
    rig.arm(purpose="back_off")
    assert rig.is_at_rest()
    start = pin.SE3(rig.T)

    def send(number: int, T: pin.SE3, speed: Speed) -> None:
        permission = rig.permission(purpose="back_off")
        rig.send("goal", goal=pose_goal(number, T), speed=speed, permission=permission)

    wrong = [
        (shifted(start, z_m=-0.004), slow),
        (shifted(start, x_m=0.004), slow),
        (shifted(start, z_m=0.004), Speed(mechanical_m_s=0.02)),
    ]
    for number, (T, speed) in enumerate(wrong, start=1):
        send(number, T, speed)
        rig.until(lambda id_=number: rig.state.goal.id == id_)  # type: ignore[misc]
        rig.until(lambda: rig.state.goal.state == "refused")
        assert distance_m(rig.T, start) < 3e-4
    send(9, shifted(start, z_m=0.004), slow)
    rig.until(lambda: rig.state.goal.id == 9 and rig.state.goal.state == "done")
    assert rig.T.translation[2] - start.translation[2] == pytest.approx(0.004, abs=5e-4)
