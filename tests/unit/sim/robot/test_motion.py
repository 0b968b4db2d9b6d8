"""The controller's own motions: straight lines on a trapezoid, and the end of a stream."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.motion.frames import rotation_between
from common.motion.kinematics import ArmKinematics
from forcemesh.messages import Speed
from sim.robot.motion import ACCEL_M_S2, BUSY, MotionGenerator

ARM = ArmKinematics("rs007l")
HOME = np.radians([0.0, 0.0, -90.0, 0.0, -90.0, 0.0])
T_HOME = ARM.flange_pose(HOME)
DT_S = 0.001

moves = hnp.arrays(float, 3, elements=st.floats(-0.12, 0.12))
turns = hnp.arrays(float, 3, elements=st.floats(-0.4, 0.4))
speeds = st.builds(
    Speed,
    mechanical_m_s=st.floats(0.02, 0.5),
    accel_fraction=st.floats(0.1, 1.0),
    decel_fraction=st.floats(0.1, 1.0),
)


def moved(move: np.ndarray, turn: np.ndarray | None = None) -> pin.SE3:
    """Return home's flange pose, moved and turned about base axes."""
    R = T_HOME.rotation if turn is None else pin.exp3(turn) @ T_HOME.rotation
    return pin.SE3(R, T_HOME.translation + move)


def finish(motion: MotionGenerator) -> np.ndarray:
    """Tick until the goal ends. Returns the joint commands, the first one before it."""
    rows = [motion.q_command]
    while motion.state in BUSY:
        rows.append(motion.tick(DT_S))
        assert len(rows) < 60_000, "the goal never ends"
    return np.array(rows)


def flange_speeds_m_s(q: np.ndarray) -> np.ndarray:
    """Return the flange's speed in each tick."""
    points = np.array([ARM.flange_pose(row).translation for row in q])
    return np.linalg.norm(np.diff(points, axis=0), axis=1) / DT_S


def joint_speed_share(q: np.ndarray) -> float:
    """Return the greatest joint speed as a share of that joint's limit."""
    return float((abs(np.diff(q, axis=0)) / DT_S / ARM.max_speed_rad_s).max())


@given(moves, turns, speeds)
@settings(max_examples=10, deadline=None)
def test_a_pose_goal_arrives_on_a_straight_line(move, turn, speed):
    """It ends at the goal; until then it leaves neither the line nor the axis of turning."""
    motion, goal = MotionGenerator(ARM, HOME), moved(move, turn)
    refused = motion.start_pose(goal, speed)
    assume("its limits are" not in refused)  # the far corner of these turns is beyond joint 5
    assert refused == ""
    q = finish(motion)
    assert motion.state == "done"
    assert pin.log6(ARM.flange_pose(q[-1]).actInv(goal)).vector == pytest.approx(0, abs=1e-7)
    for row in q[:: max(1, len(q) // 7)]:
        T = ARM.flange_pose(row)
        off_line = np.cross(T.translation - T_HOME.translation, move)
        off_axis = np.cross(rotation_between(T_HOME.rotation, T.rotation), turn)
        assert off_line == pytest.approx(0, abs=1e-7)
        assert off_axis == pytest.approx(0, abs=1e-7)


@given(moves, speeds)
@settings(max_examples=10, deadline=None)
def test_a_goal_keeps_speed_acceleration_and_deceleration(move, speed):
    """The flange's speed is a trapezoid within the numbers of the goal."""
    motion = MotionGenerator(ARM, HOME)
    assert motion.start_pose(moved(move), speed) == ""
    v = np.concatenate(([0.0], flange_speeds_m_s(finish(motion)), [0.0]))
    change = np.diff(v) / DT_S
    assert v.max() <= speed.mechanical_m_s * (1 + 1e-6)
    assert change.max() <= ACCEL_M_S2 * speed.accel_fraction * (1 + 1e-3) + 1e-4
    # The last two ticks share the rest of the travel: less than two ticks of deceleration.
    assert v[-3:].max() <= 2.0 * ACCEL_M_S2 * speed.decel_fraction * DT_S + 1e-6
    assert -change[:-2].min(initial=0.0) <= ACCEL_M_S2 * speed.decel_fraction * (1 + 1e-3) + 1e-4


def test_a_goal_too_fast_for_the_joints_slows_down_and_arrives():
    """Past the wrist singularity joints 4 and 6 turn fast: they stay within their limits."""
    start = np.radians([5.0, 20.0, -60.0, 0.0, -20.0, 0.0])
    T = ARM.flange_pose(start)
    turn = pin.utils.rotate("x", 0.7) @ pin.utils.rotate("y", 0.05)
    motion = MotionGenerator(ARM, start)
    goal = pin.SE3(T.rotation @ turn, T.translation)
    assert motion.start_pose(goal, Speed(mechanical_m_s=0.5)) == ""
    q = finish(motion)
    assert motion.state == "done"
    assert 0.9 < joint_speed_share(q) <= 1.0 + 1e-6
    assert pin.log6(ARM.flange_pose(q[-1]).actInv(goal)).vector == pytest.approx(0, abs=1e-7)


def test_braking_a_stream_never_goes_beyond_its_last_pose():
    """An arrived stream stops at once; one that is behind ramps down before its last pose."""
    motion = MotionGenerator(ARM, HOME)
    assert motion.setpoint(moved(np.array([0.0, 0.0, 0.0002]))) == ""
    held = motion.tick(DT_S)
    motion.brake()
    assert motion.state == "idle"
    assert np.array_equal(motion.tick(DT_S), held)
    far = moved(np.array([0.0, 0.0, 0.08]))
    assert motion.setpoint(far) == ""
    motion.tick(DT_S)
    motion.brake()
    q = finish(motion)
    assert motion.state in ("idle", "done")
    heights = np.array([ARM.flange_pose(row).translation[2] for row in q])
    assert heights.max() <= far.translation[2] + 1e-6
    assert joint_speed_share(q) <= 1.0 + 1e-6
