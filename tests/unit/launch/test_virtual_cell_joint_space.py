"""A whole cell near a wrist singularity and near the end of a joint's range."""

from math import radians

import numpy as np

from common.motion.frames import Array
from common.motion.joint_space import JOINT_MARGIN, SPEED_SHARE
from forcemesh import topics
from forcemesh.requests import ForceStartRequest, MoveRequest, PathRequest
from tests.fakes.bench import CELL
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
