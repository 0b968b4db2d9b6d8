"""What every robot on the bus promises: the same tests for all four of `robots.py`."""

import numpy as np
import pinocchio as pin

from common.motion.convert import record_of
from common.motion.frames import rotate_about_base_axes
from forcemesh.clock import NS_PER_S
from forcemesh.messages import Feedback, Gains, Speed, WrenchAtTcp
from tests.contract.rig import SENSOR_STAMP, Rig, goal, pose_goal, shifted
from tests.fakes.arm import FakeArm


def way_m(T: pin.SE3, U: pin.SE3) -> float:
    """Distance between two poses."""
    return float(np.linalg.norm(T.translation - U.translation))


def test_pose_and_joints_agree(rig: Rig) -> None:
    """The flange is where the joints put it, in the base frame at the crossing of axes 1 and 2."""
    for q in ((0.1, 0.1, -1.5, 0.1, -1.4, 0.3), (0.0, 0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0)):
        rig.arm()
        rig.say("goal", goal=goal(1, "joints", joint_rad=q))
        rig.until(lambda: rig.state.goal.state == "done")
        rig.say("idle")
        assert rig.is_at_rest()
        T = FakeArm().pose(rig.joint_rad)
        assert np.abs(T.translation - rig.T.translation).max() < 1e-4
        assert np.abs(T.rotation - rig.T.rotation).max() < 2e-4


def test_a_robot_without_a_command_holds_and_says_so(rig: Rig) -> None:
    """Silence is not permission."""
    before = rig.T
    rig.advance(0.2)
    assert rig.state.hold_reason
    assert way_m(rig.T, before) < 1e-4


def test_a_command_without_permission_moves_nothing(rig: Rig) -> None:
    """A goal that carries no permission is a hold."""
    before = rig.T
    rig.say("goal", goal=pose_goal(1, shifted(before, z_m=0.02)), permission=None)
    rig.advance(0.3)
    assert rig.state.hold_reason
    assert way_m(rig.T, before) < 1e-4


def test_permission_alone_ends_the_hold_and_moves_nothing(rig: Rig) -> None:
    """Idle under permission: ready, and still."""
    before = rig.T
    rig.arm()
    rig.advance(0.2)
    assert (rig.state.hold_reason, rig.state.status.moving) == ("", False)
    assert way_m(rig.T, before) < 1e-4


def test_a_move_to_a_pose_ends_there(rig: Rig) -> None:
    """Specification a): position and orientation, and the goal is told done under its id."""
    rig.arm()
    turned = rotate_about_base_axes(rig.T.rotation, np.array([0.05, -0.1, 0.2]))
    wanted = pin.SE3(turned, shifted(rig.T, 0.02, -0.01, 0.03).translation)
    rig.say("goal", goal=pose_goal(17, wanted))
    rig.until(lambda: rig.state.goal.id == 17)
    rig.until(lambda: rig.state.goal.state == "done")
    assert rig.is_at_rest()
    assert way_m(rig.T, wanted) < 5e-4
    assert np.abs(pin.log3(wanted.rotation @ rig.T.rotation.T)).max() < 3e-3


def test_a_move_keeps_mechanical_times_modular_speed(rig: Rig) -> None:
    """Specification e): 30 mm at half of 100 mm/s take no less than 0.6 s, and not for ever."""
    rig.arm()
    wanted = shifted(rig.T, z_m=0.03)
    speed = Speed(mechanical_m_s=0.1, modular_fraction=0.5)
    started_ns = rig.clock.now_ns()
    rig.say("goal", goal=pose_goal(1, wanted), speed=speed)
    rig.until(lambda: way_m(rig.T, wanted) < 1e-3)
    took_s = (rig.clock.now_ns() - started_ns) / NS_PER_S
    assert 0.9 * 29 / 50 < took_s < 3 * 29 / 50


def test_a_move_to_joint_angles_ends_there(rig: Rig) -> None:
    """Specification b)."""
    rig.arm()
    wanted = rig.joint_rad + np.array([0.1, -0.05, 0.08, 0.1, 0.05, -0.2])
    rig.say("goal", goal=goal(1, "joints", joint_rad=tuple(wanted.tolist())))
    rig.until(lambda: rig.state.goal.state == "done")
    assert rig.is_at_rest()
    assert np.abs(rig.joint_rad - wanted).max() < 3e-3


def test_a_relative_move_happens_once_however_often_it_is_commanded(rig: Rig) -> None:
    """Specification c): the arbiter repeats a goal each period, the arm turns once."""
    rig.arm()
    start, turn = rig.joint_rad, np.array([0.1, -0.05, 0.05, 0.0, 0.0, 0.3])
    rig.say("goal", goal=goal(1, "by", joint_rad=tuple(turn.tolist())))
    rig.until(lambda: rig.state.goal.state == "done")
    rig.advance(0.3)
    assert np.abs(rig.joint_rad - start - turn).max() < 3e-3
    rig.say("goal", goal=goal(2, "by", joint_rad=tuple((-turn).tolist())))
    rig.until(lambda: rig.state.goal.id == 2 and rig.state.goal.state == "done")
    assert rig.is_at_rest()
    assert np.abs(rig.joint_rad - start).max() < 3e-3


def test_a_stream_of_set_points_is_followed(rig: Rig) -> None:
    """A ramp of 20 mm in 0.4 s: no jump at its start, and the arm ends at its end."""
    rig.arm()
    start = rig.T
    rig.say("setpoint", pose=record_of(start))
    rig.advance(0.05)
    assert way_m(rig.T, start) < 2e-4
    for step in range(1, 101):
        wanted = shifted(start, y_m=1e-4 * step, z_m=2e-4 * step)
        rig.say("setpoint", pose=record_of(wanted))
        rig.advance(0.004)
    assert rig.is_at_rest()
    assert way_m(rig.T, shifted(start, y_m=0.01, z_m=0.02)) < 3e-4
    assert rig.state.hold_reason == ""


def test_hold_brakes_a_move_and_ends_it(rig: Rig) -> None:
    """The arm stops on its way, the goal is refused with the reason, nothing goes on later."""
    rig.arm()
    start, wanted = rig.T, shifted(rig.T, x_m=0.1, z_m=0.1)
    rig.say("goal", goal=pose_goal(1, wanted))
    rig.until(lambda: way_m(rig.T, start) > 0.005)
    rig.say_hold("enough")
    rig.until(lambda: rig.state.hold_reason)
    assert rig.is_at_rest()
    assert "enough" in rig.state.hold_reason
    assert (rig.state.goal.state, "enough" in rig.state.goal.reason) == ("refused", True)
    stopped = rig.T
    assert way_m(stopped, wanted) > 0.01
    rig.arm()
    rig.advance(0.3)
    assert way_m(rig.T, stopped) < 2e-4


def test_idle_takes_a_goal_back(rig: Rig) -> None:
    """Permission goes on, the goal does not: the arm brakes."""
    rig.arm()
    start, wanted = rig.T, shifted(rig.T, x_m=0.1, z_m=0.1)
    rig.say("goal", goal=pose_goal(1, wanted))
    rig.until(lambda: way_m(rig.T, start) > 0.005)
    rig.say("idle")
    assert rig.is_at_rest()
    assert way_m(rig.T, wanted) > 0.01
    assert rig.state.hold_reason == ""


def test_silence_of_the_arbiter_stops_the_arm_and_kills_the_lease(rig: Rig) -> None:
    """After a missed permission the old lease is dead; only a new one moves the arm again."""
    rig.arm()
    start, wanted = rig.T, shifted(rig.T, x_m=0.1, z_m=0.1)
    rig.say("goal", goal=pose_goal(1, wanted))
    rig.until(lambda: way_m(rig.T, start) > 0.005)
    rig.silence()
    rig.until(lambda: rig.state.hold_reason)
    assert rig.is_at_rest()
    stopped = rig.T
    assert way_m(stopped, wanted) > 0.01
    rig.say("goal", goal=pose_goal(2, wanted))
    rig.advance(0.4)
    assert rig.state.hold_reason
    assert way_m(rig.T, stopped) < 2e-4
    rig.arm()
    rig.say("goal", goal=pose_goal(3, shifted(stopped, z_m=0.005)))
    rig.until(lambda: rig.state.goal.id == 3 and rig.state.goal.state == "done")


def test_a_goal_of_a_new_arbiter_is_not_mistaken_for_an_old_one(rig: Rig) -> None:
    """Goal ids start again when the arbiter does: the same id is another goal."""
    rig.arm()
    start = rig.T
    rig.say("goal", goal=pose_goal(1, shifted(start, z_m=0.01)))
    rig.until(lambda: rig.state.goal.state == "done")
    rig.restart_arbiter()
    rig.lease = 0
    rig.arm()
    rig.say("goal", goal=pose_goal(1, shifted(start, z_m=0.02)))
    rig.until(lambda: way_m(rig.T, shifted(start, z_m=0.02)) < 5e-4)


def test_a_set_point_far_away_is_refused_and_holds(rig: Rig) -> None:
    """A jump of half a metre is a mistake of somebody, not a motion."""
    rig.arm()
    before = rig.T
    rig.say("setpoint", pose=record_of(shifted(before, x_m=0.3, z_m=0.4)))
    rig.until(lambda: rig.state.hold_reason)
    rig.advance(0.2)
    assert way_m(rig.T, before) < 2e-4


def test_a_second_goal_does_not_hurry_past_the_first(rig: Rig) -> None:
    """While one is on its way another is refused under its own id."""
    rig.arm()
    start = rig.T
    rig.say("goal", goal=pose_goal(1, shifted(start, x_m=0.1, z_m=0.1)))
    rig.until(lambda: way_m(rig.T, start) > 0.005)
    rig.say("goal", goal=pose_goal(2, shifted(start, x_m=-0.1)))
    rig.until(lambda: rig.state.goal.id == 2)
    assert (rig.state.goal.state, bool(rig.state.goal.reason)) == ("refused", True)
    rig.say("idle")
    assert rig.is_at_rest()
    assert rig.T.translation[0] >= start.translation[0] - 1e-4


def test_force_feedback_needs_a_permission_that_names_the_controller(rig: Rig) -> None:
    """Host pc permits streamed poses only."""
    rig.arm()
    before = rig.T
    rig.wrench = WrenchAtTcp(force_N=(0.0, 0.0, 10.0))
    gains = Gains(force_p_m_per_N=(1e-6, 1e-6, 1e-6))
    rig.say("feedback", feedback=Feedback(mode="position", gains=gains))
    rig.until(lambda: rig.state.hold_reason)
    assert way_m(rig.T, before) < 1e-4


def test_the_echo_names_the_command_and_the_sensor_sample_behind_it(rig: Rig) -> None:
    """From the echo everybody can tell how old the wrench behind a motion was."""
    rig.arm()
    rig.advance(0.05)
    accepted = rig.state.accepted
    assert accepted is not None
    assert 0 <= rig.command_seq - accepted.seq < 30
    assert (accepted.sensor_stamp_ns, accepted.sensor_seq) == SENSOR_STAMP


def test_the_state_comes_at_its_rate(rig: Rig) -> None:
    """As often as the cell says, within a third."""
    rig.states.clear()
    rig.advance(0.5)
    wanted = 0.5 * rig.cell.rates.robot_hz
    assert 0.66 * wanted < len(rig.states) < 1.34 * wanted
