"""Promises of every robot on the bus: the same tests for all four of `robots.py`."""

import numpy as np
import pinocchio as pin

from common.motion.convert import record_of
from common.motion.frames import rotate_about_base_axes
from common.motion.kinematics import ArmKinematics
from forcemesh.messages import Feedback, Gains, WrenchAtTcp
from tests.contract.rig import SENSOR_STAMP, Rig, distance_m, goal, pose_goal, shifted


def test_pose_and_joints_agree(rig: Rig) -> None:
    """The flange has the pose of the joints, in the base frame at the crossing of axes 1 and 2."""
    for q in ((0.1, 0.1, -1.5, 0.1, -1.4, 0.3), (0.0, 0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0)):
        rig.arm()
        rig.send("goal", goal=goal(1, "joints", joint_rad=q))
        rig.until(lambda: rig.state.goal.state == "done")
        rig.send("idle")
        assert rig.is_at_rest()
        T = ArmKinematics(rig.cell.robot.model).flange_pose(rig.joint_rad)
        assert np.abs(T.translation - rig.T.translation).max() < 1e-4
        assert np.abs(T.rotation - rig.T.rotation).max() < 2e-4


def test_a_command_without_permission_moves_nothing(rig: Rig) -> None:
    """A goal that carries no permission is a hold."""
    before = rig.T
    rig.send("goal", goal=pose_goal(1, shifted(before, z_m=0.02)), permission=None)
    rig.advance(0.3)
    assert rig.state.hold_reason
    assert distance_m(rig.T, before) < 1e-4


def test_permission_alone_ends_the_hold_and_moves_nothing(rig: Rig) -> None:
    """Idle under permission: ready, and at rest."""
    before = rig.T
    rig.arm()
    rig.advance(0.2)
    assert (rig.state.hold_reason, rig.state.status.moving) == ("", False)
    assert distance_m(rig.T, before) < 1e-4


def test_a_move_to_a_pose_ends_there(rig: Rig) -> None:
    """Specification a): position and orientation, and the goal is reported done under its id."""
    rig.arm()
    turned = rotate_about_base_axes(rig.T.rotation, np.array([0.05, -0.1, 0.2]))
    target = pin.SE3(turned, shifted(rig.T, 0.02, -0.01, 0.03).translation)
    rig.send("goal", goal=pose_goal(17, target))
    rig.until(lambda: rig.state.goal.id == 17)
    rig.until(lambda: rig.state.goal.state == "done")
    assert rig.is_at_rest()
    assert distance_m(rig.T, target) < 5e-4
    assert np.abs(pin.log3(target.rotation @ rig.T.rotation.T)).max() < 3e-3


def test_a_move_to_joint_angles_ends_there(rig: Rig) -> None:
    """Specification b)."""
    rig.arm()
    target = rig.joint_rad + np.array([0.1, -0.05, 0.08, 0.1, 0.05, -0.2])
    rig.send("goal", goal=goal(1, "joints", joint_rad=tuple(target.tolist())))
    rig.until(lambda: rig.state.goal.state == "done")
    assert rig.is_at_rest()
    assert np.abs(rig.joint_rad - target).max() < 3e-3


def test_a_relative_move_happens_once_however_often_it_is_commanded(rig: Rig) -> None:
    """Specification c): the arbiter repeats a goal each period, the arm turns once."""
    rig.arm()
    start, turn = rig.joint_rad, np.array([0.1, -0.05, 0.05, 0.0, 0.0, 0.3])
    rig.send("goal", goal=goal(1, "by", joint_rad=tuple(turn.tolist())))
    rig.until(lambda: rig.state.goal.state == "done")
    rig.advance(0.3)
    assert np.abs(rig.joint_rad - start - turn).max() < 3e-3
    rig.send("goal", goal=goal(2, "by", joint_rad=tuple((-turn).tolist())))
    rig.until(lambda: rig.state.goal.id == 2 and rig.state.goal.state == "done")
    assert rig.is_at_rest()
    assert np.abs(rig.joint_rad - start).max() < 3e-3


def test_a_stream_of_set_points_is_followed(rig: Rig) -> None:
    """A ramp of 20 mm in 0.4 s: no jump at its start, and the arm ends at its end."""
    rig.arm()
    start = rig.T
    rig.send("setpoint", pose=record_of(start))
    rig.advance(0.05)
    assert distance_m(rig.T, start) < 2e-4
    for step in range(1, 101):
        target = shifted(start, y_m=1e-4 * step, z_m=2e-4 * step)
        rig.send("setpoint", pose=record_of(target))
        rig.advance(0.004)
    assert rig.is_at_rest()
    assert distance_m(rig.T, shifted(start, y_m=0.01, z_m=0.02)) < 3e-4
    assert rig.state.hold_reason == ""


def test_silence_of_the_arbiter_stops_the_arm_and_kills_the_lease(rig: Rig) -> None:
    """After a missed permission the old lease is dead; only a new one moves the arm again."""
    rig.arm()
    start, target = rig.T, shifted(rig.T, x_m=0.1, z_m=0.1)
    rig.send("goal", goal=pose_goal(1, target))
    rig.until(lambda: distance_m(rig.T, start) > 0.005)
    rig.silence()
    rig.until(lambda: rig.state.hold_reason)
    assert rig.is_at_rest()
    stopped = rig.T
    assert distance_m(stopped, target) > 0.01
    rig.send("goal", goal=pose_goal(2, target))
    rig.advance(0.4)
    assert rig.state.hold_reason
    assert distance_m(rig.T, stopped) < 2e-4
    rig.arm()
    rig.send("goal", goal=pose_goal(3, shifted(stopped, z_m=0.005)))
    rig.until(lambda: rig.state.goal.id == 3 and rig.state.goal.state == "done")


def test_a_goal_of_a_new_arbiter_is_not_mistaken_for_an_old_one(rig: Rig) -> None:
    """Goal ids start again when the arbiter does: the same id is another goal."""
    rig.arm()
    start = rig.T
    rig.send("goal", goal=pose_goal(1, shifted(start, z_m=0.01)))
    rig.until(lambda: rig.state.goal.state == "done")
    rig.silence()
    rig.until(lambda: rig.state.hold_reason)
    rig.restart_arbiter()
    rig.lease = 0
    rig.arm()
    rig.send("goal", goal=pose_goal(1, shifted(start, z_m=0.02)))
    rig.until(lambda: distance_m(rig.T, shifted(start, z_m=0.02)) < 5e-4)


def test_a_set_point_far_away_is_refused_and_holds(rig: Rig) -> None:
    """A jump of half a metre is an error of a client, not a motion."""
    rig.arm()
    before = rig.T
    rig.send("setpoint", pose=record_of(shifted(before, x_m=0.3, z_m=0.4)))
    rig.until(lambda: rig.state.hold_reason)
    rig.advance(0.2)
    assert distance_m(rig.T, before) < 2e-4


def test_a_second_goal_does_not_replace_the_first(rig: Rig) -> None:
    """During a goal another one is refused under its own id."""
    rig.arm()
    start = rig.T
    rig.send("goal", goal=pose_goal(1, shifted(start, x_m=0.1, z_m=0.1)))
    rig.until(lambda: distance_m(rig.T, start) > 0.005)
    rig.send("goal", goal=pose_goal(2, shifted(start, x_m=-0.1)))
    rig.until(lambda: rig.state.goal.id == 2)
    assert (rig.state.goal.state, bool(rig.state.goal.reason)) == ("refused", True)
    rig.send("idle")
    assert rig.is_at_rest()
    assert rig.T.translation[0] >= start.translation[0] - 1e-4


def test_force_feedback_needs_a_permission_that_names_the_controller(rig: Rig) -> None:
    """Host pc permits streamed poses only."""
    rig.arm()
    before = rig.T
    rig.wrench = WrenchAtTcp(force_N=(0.0, 0.0, 10.0))
    gains = Gains(force_p_m_per_N=(1e-6, 1e-6, 1e-6))
    rig.send("feedback", feedback=Feedback(mode="position", gains=gains))
    rig.until(lambda: rig.state.hold_reason)
    assert distance_m(rig.T, before) < 1e-4


def test_the_echo_names_the_command_and_the_sensor_sample_behind_it(rig: Rig) -> None:
    """The echo lets every client compute the age of the wrench behind a motion."""
    rig.arm()
    rig.advance(0.05)
    accepted = rig.state.accepted
    assert accepted is not None
    assert 0 <= rig.command_seq - accepted.seq < 30
    assert (accepted.sensor_stamp_ns, accepted.sensor_seq) == SENSOR_STAMP


def test_the_state_comes_at_its_rate(rig: Rig) -> None:
    """At the rate of the cell file, within a third."""
    rig.states.clear()
    rig.advance(0.5)
    target = 0.5 * rig.cell.rates.robot_hz
    assert 0.66 * target < len(rig.states) < 1.34 * target
