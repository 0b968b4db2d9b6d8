"""A whole cell near a wrist singularity and near the end of a joint's range."""

from math import radians

import numpy as np

from common.config.load import load_cell
from common.motion.frames import Array
from common.motion.joint_space import JOINT_MARGIN, SPEED_SHARE
from forcemesh import topics
from forcemesh.requests import ForceStartRequest, MoveRequest, PathRequest
from tests.fakes.bench import CELL, DEMO
from tests.fakes.lab import Lab

MOST_RAD_S = (
    JOINT_MARGIN
    * SPEED_SHARE
    * CELL.limits.joint_speed_share
    * np.radians(CELL.robot.joint_speed_max_deg_s)
)


PRESS = ForceStartRequest(mode="position", setpoint_N=10.0)


def lab_at(joint_deg: tuple[float, ...]) -> Lab:
    """Return an armed cell whose arm has moved to joint angles."""
    lab = Lab(CELL)
    joint_rad = tuple(map(radians, joint_deg))
    assert lab.ask(topics.MOVE, MoveRequest(kind="joints", joint_rad=joint_rad)).accepted
    lab.finish_move(20.0)
    return lab


def path_across(lab: Lab, length_m: float, speed_m_s: float) -> PathRequest:
    """Return a path along base x, which is followed without contact."""
    x, y, z = lab.cell.arm.T_base_tcp.translation.tolist()
    return PathRequest(points_m=((x + length_m, y, z),), speed_m_s=speed_m_s, in_contact=False)


def test_a_path_beside_the_wrist_singularity_is_slowed_and_followed() -> None:
    """The joints stay below their limits, and the tool arrives, later than it would elsewhere."""
    lab = lab_at((0.0, 0.0, -90.0, 0.0, -1.0, 0.0))
    assert lab.ask(topics.FORCE_START, PRESS).accepted
    lab.cell.advance(0.2)
    start = lab.p_m()
    assert lab.ask(topics.FORCE_PATH, path_across(lab, 0.02, 0.02)).accepted
    angles: list[Array] = []
    slowed = 0
    for _ in range(500):
        lab.cell.advance(0.004)
        angles.append(lab.q_command())
        command = lab.now(lab.command)
        assert command.kind == "setpoint", lab.status.trips
        slowed += command.limited
    assert slowed > 50
    assert lab.p_m()[0] - start[0] > 0.019
    speed_rad_s = np.abs(np.diff(angles[::5], axis=0)) / 0.02
    assert (speed_rad_s <= MOST_RAD_S).all()
    assert speed_rad_s[:, 3].max() > 1.0, "joint 4 swings round"


def test_a_path_that_is_too_fast_there_is_refused_with_point_and_joint() -> None:
    """At 50 mm/s joint 4 would be above its limit; nothing changes."""
    lab = lab_at((0.0, 0.0, -90.0, 0.0, -0.5, 0.0))
    assert lab.ask(topics.FORCE_START, PRESS).accepted
    lab.cell.advance(0.1)
    reply = lab.ask(topics.FORCE_PATH, path_across(lab, 0.02, 0.05))
    assert (reply.accepted, reply.code) == (False, "joint_speed")
    assert reply.text.startswith("point 1: joint 4 would turn at ")
    assert lab.now(lab.command).kind == "setpoint"


def test_force_feedback_near_the_end_of_a_range_holds_and_names_the_joint() -> None:
    """The approach would leave the range of joint 3, which the cell file narrows."""
    ranges = {
        "robot.joint_min_deg": [-180, -135, -91, -200, -125, -360],
        "robot.joint_max_deg": [180, 135, -89, 200, 125, 360],
    }
    lab = Lab(load_cell(DEMO, {**ranges, "sim.gap_m": 0.1}))
    assert lab.ask(topics.FORCE_START, PRESS).accepted
    lab.seconds_until(lambda: lab.status.state == "HOLDING", 5.0)
    (trip,) = lab.status.trips
    assert (trip.code, trip.unit) == ("joint", "rad")
    assert trip.text.startswith("joint 3 = -")
    assert trip.limit in {radians(-91.0), radians(-89.0)}
    low, high = radians(-91.1), radians(-88.9)
    lab.cell.advance(0.3)
    assert low < lab.cell.arm.q[2] < high
    lab.assert_still(0.3)
