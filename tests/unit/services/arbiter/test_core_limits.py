"""Limits of the measured arm while it may move: joints, planes, and a faulty regulator."""

from itertools import pairwise
from math import radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.cell import LimitsSection
from common.motion.convert import pose_of, record_of
from common.motion.frames import rotation_between, rotation_from_vector
from forcemesh.messages import PoseRecord
from tests.fakes.arbiter_world import CELL, PERIOD_NS, T_START, World, shifted

DT_S = PERIOD_NS * 1e-9
LIMITS = CELL.limits
SLACK_RAD = radians(0.5)
SPEED_DEG_S = [LIMITS.joint_speed_share * v for v in CELL.robot.joint_speed_max_deg_s]
each_motion = pytest.mark.parametrize("motion", ["none", "operator", "regulator"])


def joints(number: int, angle_rad: float) -> tuple[float, ...]:
    """Return joint angles of zero but for one."""
    return tuple(angle_rad if index == number - 1 else 0.0 for index in range(6))


def prepared(motion: str, world: World | None = None) -> World:
    """Return an arbiter that is ARMED, or ACTIVE under a commander."""
    world = world or World()
    return world.make_armed() if motion == "none" else world.make_active(motion)


@each_motion
@pytest.mark.parametrize("number", range(1, 7))
def test_a_measured_joint_beyond_its_range_holds(motion: str, number: int) -> None:
    """Swept: the limit itself and a rounding beyond it are allowed."""
    limit_rad = radians(CELL.robot.joint_max_deg[number - 1])
    world = World()
    world.change("robot", joint_rad=joints(number, limit_rad + 0.9 * SLACK_RAD))
    prepared(motion, world)
    assert world.tick(30).permission is not None
    world.change("robot", joint_rad=joints(number, limit_rad + 1.1 * SLACK_RAD))
    assert world.tick().permission is None
    (trip,) = world.core.status().trips
    assert (trip.code, f"joint {number} " in trip.text) == ("joint", True)


@each_motion
@pytest.mark.parametrize("number", [1, 6])
@pytest.mark.parametrize("share", [0.95, 1.05])
def test_a_joint_that_turns_too_fast_holds(motion: str, number: int, share: float) -> None:
    """The speed is measured over its window; slightly below the limit it may continue."""
    world = World()
    world.change("robot", joint_rad=joints(number, -1.0))
    prepared(motion, world)
    speed_rad_s = share * radians(SPEED_DEG_S[number - 1])
    periods = 0
    while world.core.state != "HOLDING" and periods < 60:
        periods += 1
        world.change("robot", joint_rad=joints(number, -1.0 + speed_rad_s * periods * DT_S))
        world.tick()
    assert (world.core.state == "HOLDING") == (share > 1.0)
    if share > 1.0:
        assert world.core.status().trips[0].code == "joint_speed"
        assert periods == pytest.approx(0.1 / DT_S, abs=2)


@each_motion
def test_the_tool_behind_a_plane_holds(motion: str) -> None:
    """The measured TCP is checked against planes as against the box."""
    wall_m = float(T_START.translation[1]) + 0.01
    plane = {"point_m": (0.0, wall_m, 0.0), "normal": (0.0, -2.0, 0.0)}
    limits = LimitsSection.model_validate(LIMITS.model_dump() | {"planes": [plane]})
    world = prepared(motion, World(CELL.model_copy(update={"limits": limits})))
    world.place(pose_of(shifted(y_m=0.0099)))
    assert world.tick().permission is not None
    world.place(pose_of(shifted(y_m=0.0101)))
    assert world.tick().permission is None
    (trip,) = world.core.status().trips
    assert (trip.code, "plane 1" in trip.text) == ("workspace", True)


any_motion = st.tuples(*[st.floats(-0.5, 0.5)] * 3, *[st.floats(-1.0, 1.0)] * 3)


@settings(max_examples=40)
@given(st.lists(st.tuples(any_motion, st.integers(1, 12), st.booleans()), min_size=1, max_size=8))
def test_a_faulty_regulator_stays_within_speed_acceleration_and_workspace(proposals) -> None:
    """For any proposals, durations and failures every command keeps every limit."""
    world = World().make_active("regulator")
    sent_poses: list[PoseRecord] = [record_of(T_START)]
    for (x_m, y_m, z_m, *turn), periods, rests in proposals:
        R = rotation_from_vector(np.array(turn)) @ T_START.rotation
        proposal = pin.SE3(R, T_START.translation + np.array([x_m, y_m, z_m]))
        world.propose(record_of(proposal))
        for _ in range(periods):
            command = world.tick()
            if command.kind == "setpoint" and command.pose is not None:
                sent_poses.append(command.pose)
                world.place(pose_of(command.pose))
        if rests:
            world.propose(None, valid=False)
    poses = [pose_of(pose) for pose in sent_poses]
    travels = [b.translation - a.translation for a, b in pairwise(poses)]
    turns = [rotation_between(a.rotation, b.rotation) for a, b in pairwise(poses)]
    fastest = (LIMITS.speed_m_s * DT_S, radians(LIMITS.speed_deg_s) * DT_S)
    hardest = (LIMITS.accel_m_s2 * DT_S**2, radians(LIMITS.accel_deg_s2) * DT_S**2)
    for steps, limit, change in zip((travels, turns), fastest, hardest, strict=True):
        sizes = [float(np.linalg.norm(step)) for step in steps]
        changes = [float(np.linalg.norm(b - a)) for a, b in pairwise(steps)]
        assert max(sizes, default=0.0) <= limit * (1.0 + 1e-6) + 1e-9
        assert max(changes, default=0.0) <= change * (1.0 + 1e-6) + 1e-8
    low, high = np.array(LIMITS.workspace_min_m), np.array(LIMITS.workspace_max_m)
    for T in poses:
        tip = (T * CELL.tool.T_flange_tcp.pose).translation
        assert ((tip >= low) & (tip <= high)).all()
