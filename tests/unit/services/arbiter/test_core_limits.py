"""Limits of the measured arm while it may move, and of the set points of a faulty regulator."""

from itertools import pairwise
from math import radians
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.cell import LimitsSection
from common.motion.convert import pose_of, record_of
from common.motion.frames import rotation_between, rotation_from_vector
from forcemesh.messages import PoseRecord
from tests.fakes.arbiter_world import CELL, PERIOD_NS, STOPPED, T_START, World, distance_m, shifted

DT_S = PERIOD_NS * 1e-9
LIMITS = CELL.limits
each_motion = pytest.mark.parametrize("motion", ["none", "operator", "regulator"])

PLANE = {"point_m": (-0.35, 0.25, 0.0), "normal": (2.0, 2.0, 0.0)}
BOUNDED = CELL.model_copy(
    update={
        "limits": LimitsSection.model_validate(
            LIMITS.model_dump() | {"tether_m": 0.5, "planes": [PLANE]}
        )
    }
)
TINY = 1e-5


def tip_at(x_m: float, y_m: float, z_m: float) -> dict[str, Any]:
    """Return the report of an arm whose tool points down and ends in a place."""
    return record_of(pin.SE3(T_START.rotation, np.array([x_m, y_m, z_m + 0.16]))).as_dict()


def turned(turn_deg: float) -> dict[str, Any]:
    """Return the report of an arm that is turned about the tool's axis."""
    R = pin.utils.rotate("z", radians(turn_deg)) @ T_START.rotation
    return record_of(pin.SE3(R, T_START.translation)).as_dict()


def away(travel_m: float) -> dict[str, Any]:
    """Return the report of an arm that is so far away, sideways and upwards."""
    return record_of(pose_of(shifted(x_m=0.6 * travel_m, z_m=0.8 * travel_m))).as_dict()


def joint_at(number: int, deg: float) -> dict[str, Any]:
    """Return a report in which one joint, counted from 1, is not at zero."""
    return {"joint_rad": tuple(radians(deg) * (each == number) for each in range(1, 7))}


# Limit, input, and its fields at the limit and beyond it.
Row = tuple[str, str, dict[str, Any], dict[str, Any]]
MEASURED: dict[str, Row] = {
    "force": ("force", "wrench", {"force_N": (0.0, 0.0, 60.0)}, {"force_N": (0.0, 0.0, 60.01)}),
    "torque": ("torque", "wrench", {"torque_Nm": (0.0, 10.0, 0.0)},
               {"torque_Nm": (0.0, 10.01, 0.0)}),
    "x min": ("workspace", "robot", tip_at(TINY - 0.4, 0.5, 0.2), tip_at(-0.4 - TINY, 0.5, 0.2)),
    "x max": ("workspace", "robot", tip_at(0.4 - TINY, 0.5, 0.2), tip_at(0.4 + TINY, 0.5, 0.2)),
    "y min": ("workspace", "robot", tip_at(0.0, 0.2 + TINY, 0.2), tip_at(0.0, 0.2 - TINY, 0.2)),
    "y max": ("workspace", "robot", tip_at(0.0, 0.8 - TINY, 0.2), tip_at(0.0, 0.8 + TINY, 0.2)),
    "z min": ("workspace", "robot", tip_at(0.0, 0.5, TINY - 0.2), tip_at(0.0, 0.5, -0.2 - TINY)),
    "z max": ("workspace", "robot", tip_at(0.0, 0.5, 0.6 - TINY), tip_at(0.0, 0.5, 0.6 + TINY)),
    "plane": ("workspace", "robot", tip_at(TINY - 0.35, 0.25, 0.2),
              tip_at(-0.35 - TINY, 0.25, 0.2)),
    "tether": ("tether", "robot", away(0.5 - TINY), away(0.5 + TINY)),
    "tether's turn": ("tether", "robot", turned(149.99), turned(150.01)),
    **{f"joint {number}": ("joint", "robot", joint_at(number, deg + 0.49),
                           joint_at(number, deg + 0.51))
       for number, deg in enumerate(CELL.robot.joint_max_deg, start=1)},
}  # fmt: skip


@each_motion
@pytest.mark.parametrize("row", MEASURED)
def test_a_limit_of_the_measured_arm_ends_every_motion(motion: str, row: str) -> None:
    """Swept: the limit itself is allowed, and half a degree of a joint's range."""
    code, name, within, beyond = MEASURED[row]
    for changes, is_over in ((within, False), (beyond, True)):
        world = World(BOUNDED)
        if code == "joint":
            world.change(name, **within)  # else the joint jumps
        world.make_armed()
        world.change("wrench", force_N=(0.0, 0.0, 50.0))  # limits.move_rise_N does not trip first
        if motion != "none":
            world.activate(motion)
        if not is_over:
            world.messages["target"] = STOPPED  # else its set points are a step away
        world.change(name, **changes)
        assert (world.tick().permission is None) == is_over
        assert [trip.code for trip in world.core.trips] == [code] * is_over
        assert (world.core.state == "HOLDING") == is_over


@each_motion
@pytest.mark.parametrize("share", [0.95, 1.05])
def test_a_joint_that_turns_too_fast_holds(motion: str, share: float) -> None:
    """Within a tenth of a second; slightly below the limit it continues."""
    world = World().make_armed()
    if motion != "none":
        world.activate(motion)
    speed_deg_s = share * LIMITS.joint_speed_share * CELL.robot.joint_speed_max_deg_s[5]
    for period in range(27):
        world.change("robot", **joint_at(6, speed_deg_s * period * DT_S))
        world.tick()
    assert (world.core.state == "HOLDING") == (share > 1.0)
    assert [trip.code for trip in world.core.trips] == ["joint_speed"] * (share > 1.0)


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


def test_a_late_arbiter_advances_set_points_by_three_periods_at_most() -> None:
    """From rest: a longer time would be a jump."""
    world = World().make_active("regulator")
    world.propose(shifted(x_m=0.1))
    pose = world.tick(period_ns=10 * PERIOD_NS).pose
    assert distance_m(pose, shifted()) == pytest.approx(LIMITS.accel_m_s2 * (3.0 * DT_S) ** 2)
