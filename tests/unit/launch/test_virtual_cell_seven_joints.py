"""A whole cell with an arm of seven joints: one folder in arms/ and one cell file."""

from pathlib import Path

import numpy as np
import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.errors import ConfigError
from forcemesh.requests import ForceStartRequest, MoveRequest
from sim.robot.scene import plate_at_rest
from tests.fakes.lab import PRESS_N, Lab

PANDA = Path(__file__).resolve().parents[3] / "cells" / "panda.yaml"
SETTLED_N, SETTLED_NM = 1.0, 0.1


@pytest.fixture(scope="module")
def lab() -> Lab:
    """The armed cell over a tilted plate."""
    return Lab(load_cell(PANDA, {"sim.tilt_deg": 5.0}))


def test_seven_joints_are_reported_and_moved(lab: Lab) -> None:
    """A move by joint angles takes seven of them; six are refused."""
    before = lab.cell.arm.q
    assert len(lab.state.joint_rad) == 7
    turns = (0.0, 0.0, 0.1, 0.0, -0.1, 0.0, 0.2)
    refused = lab.ask(topics.MOVE, MoveRequest(kind="by", joint_rad=turns[:6]))
    assert "6 joint angles, the arm of the cell file has 7 joints" in refused.text
    for sign in (1.0, -1.0):
        goal = before + np.array(turns) * max(sign, 0.0)
        move = MoveRequest(kind="by", joint_rad=tuple(sign * turn for turn in turns))
        assert lab.ask(topics.MOVE, move).accepted
        lab.finish_move(20.0)
        assert lab.cell.arm.q == pytest.approx(goal, abs=1e-3)


def test_force_control_settles(lab: Lab) -> None:
    """Force and torque reach their set points on a plate that is tilted by five degrees."""
    start = ForceStartRequest(mode="both", setpoint_N=PRESS_N)
    assert lab.ask(topics.FORCE_START, start).accepted
    lab.cell.advance(4.0)
    for _ in range(10):
        lab.cell.advance(0.1)
        wrench = lab.now(lab.wrench)
        assert np.linalg.norm(wrench.force_N) == pytest.approx(PRESS_N, abs=SETTLED_N)
        assert np.linalg.norm(wrench.torque_Nm) < SETTLED_NM
    tool, normal = (
        lab.cell.arm.T_base_tcp.rotation[:, 2],
        plate_at_rest(lab.cell.arm.settings).normal,
    )
    assert np.degrees(np.arccos(-tool @ normal)) < 0.5
    assert lab.status.state == "ACTIVE"


def test_the_gateway_refuses_seven_joints() -> None:
    """The packet of a Kawasaki controller has six."""
    with pytest.raises(ConfigError, match=r"packet has 6 joints, panda has 7; roles\.robot"):
        load_cell(PANDA, {"roles.robot": "gateway", "gateway": {}})
