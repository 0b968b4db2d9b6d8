"""Paths in joint space: what is refused before it starts, with point, joint, value and limit."""

from math import radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.arm import read_arm
from common.config.load import load_cell
from common.motion.convert import pose_of, record_of
from common.motion.frames import Array, moved
from common.motion.joint_paths import move_obstacle, path_obstacle, tool_path_trips
from common.motion.joint_space import JointSpace
from common.motion.kinematics import ArmKinematics
from forcemesh.messages import Goal, RobotState
from tests.fakes.bench import DEMO

CELL = load_cell(DEMO)
SPACE = JointSpace(CELL, ArmKinematics(CELL.robot.model))
HOME = np.radians(read_arm("rs007l").home_deg)
T_FLANGE_TCP = CELL.tool.T_flange_tcp.pose
STILL = (0.0, 0.0, 0.0)


def robot_at(q: Array) -> RobotState:
    """Return the report of an arm at joint angles."""
    record = record_of(SPACE.arm.flange_pose(q))
    return RobotState(
        joint_rad=tuple(q.tolist()),
        position_m=record.position_m,
        orientation_xyzw=record.orientation_xyzw,
    )


def goal_at(T_base_flange: pin.SE3) -> Goal:
    """Return a move to a pose."""
    return Goal(id=1, kind="pose", pose=record_of(T_base_flange))


AT_HOME = robot_at(HOME)
T_HOME = pose_of(AT_HOME)


def test_a_move_beyond_the_reach_is_refused_with_the_lengths() -> None:
    """The wrist would be farther away than the arm is long."""
    q = np.radians([0.0, 45.0, -60.0, 0.0, 20.0, 0.0])
    T = SPACE.arm.flange_pose(q)
    out = pin.SE3(T.rotation, T.translation + np.array([0.0, 0.4, 0.0]))
    trip = move_obstacle(SPACE, goal_at(out), robot_at(q))
    assert trip is not None
    assert trip.code == "unreachable"
    assert trip.text.startswith("on the path: out of reach: the wrist would be ")
    assert "the arm is 930 mm long" in trip.text


def test_a_move_that_leaves_a_joints_range_is_refused_with_joint_value_and_limit() -> None:
    """The flange turns about its own axis, beyond what joint 6 has left."""
    q = HOME.copy()
    q[5] = radians(350.0)
    T = moved(SPACE.arm.flange_pose(q), (STILL, (0.0, 0.0, -0.3)), 1.0)
    trip = move_obstacle(SPACE, goal_at(T), robot_at(q))
    assert trip is not None
    assert (trip.code, trip.limit) == ("joint", pytest.approx(radians(360.0)))
    assert trip.text.startswith("on the path: joint 6 = 36")
    back = moved(SPACE.arm.flange_pose(q), (STILL, (0.0, 0.0, 0.3)), 1.0)
    assert move_obstacle(SPACE, goal_at(back), robot_at(q)) is None


def test_what_has_no_path_or_no_model_is_not_checked() -> None:
    """A joint move, an arm without a model, a pose that is not the model's."""
    far = goal_at(pin.SE3(T_HOME.rotation, np.array([0.0, 3.0, 0.0])))
    joints = Goal(id=1, kind="joints", joint_rad=(0.0,) * 6)
    assert move_obstacle(SPACE, joints, AT_HOME) is None
    assert move_obstacle(None, far, AT_HOME) is None
    elsewhere = AT_HOME.replaced(joint_rad=(0.0,) * 6)
    assert move_obstacle(SPACE, far, elsewhere) is None


def test_a_path_is_refused_at_the_point_where_a_joint_is_too_fast() -> None:
    """Beside the wrist singularity at 250 mm/s; slowly, or without a speed, it is accepted."""
    q = HOME.copy()
    q[4] = radians(-3.0)
    robot = robot_at(q)
    T = pose_of(robot)
    R, p = T.rotation, T.translation
    across = np.array([1.0, 0.0, 0.0])  # joint 1 turns, and only joint 4 can turn the wrist back
    poses = [pin.SE3(R, p + 0.0005 * across), pin.SE3(R, p + 0.03 * across)]
    found = path_obstacle(SPACE, poses, robot, T, speed_m_s=0.25)
    assert found is not None
    assert (found.point, found.trip.code) == (1, "joint_speed")
    assert found.trip.value is not None
    assert found.trip.limit is not None
    assert found.trip.value > found.trip.limit
    assert path_obstacle(SPACE, poses, robot, T, speed_m_s=0.02) is None
    assert path_obstacle(SPACE, poses, robot, T) is None


def test_a_tool_path_is_refused_with_the_number_of_its_point() -> None:
    """Whichever pose of the tool no joint angles reach."""
    T_tcp = T_HOME * T_FLANGE_TCP
    p = T_tcp.translation
    near, far = (p + np.array(step) for step in ([0.05, 0.0, 0.0], [0.0, 0.9, 0.0]))

    def refusal(*points: Array, robot: RobotState | None = AT_HOME) -> str:
        *_, reply = None, *tool_path_trips(
            SPACE,
            [pin.SE3(T_tcp.rotation, point) for point in points],
            robot,
            T_tcp,
            T_tcp_flange=T_FLANGE_TCP.inverse(),
            speed_m_s=0.02,
        )  # fmt: skip
        return "" if reply is None else f"{reply.code}: {reply.text}"

    assert refusal() == ""
    assert refusal(near, p) == ""
    assert refusal(near, far).startswith(("unreachable: point 2: ", "joint: point 2: "))
    assert refusal(near, far, robot=None) == ""


@given(hnp.arrays(float, 3, elements=st.floats(-0.15, 0.15)))
def test_a_path_that_begins_elsewhere_is_judged_from_its_beginning_on(shift_m) -> None:
    """What leads there is followed already: it has no speed and no number."""
    T_from = pin.SE3(T_HOME.rotation, T_HOME.translation + shift_m)
    near = pin.SE3(T_from.rotation, T_from.translation + 0.001)
    far = pin.SE3(T_from.rotation, np.array([0.0, 3.0, 0.0]))
    assert path_obstacle(SPACE, [near], AT_HOME, T_from, speed_m_s=0.02) is None
    found = path_obstacle(SPACE, [near, far], AT_HOME, T_from, speed_m_s=0.02)
    assert found is not None
    assert found.point == 2
    assert found.trip.code in {"unreachable", "joint"}  # whichever comes first
