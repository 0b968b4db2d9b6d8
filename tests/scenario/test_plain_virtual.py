"""A whole cell with protocol plain, in lock step: requests of a client, plain.as, and the arm."""

import numpy as np
import pytest

from common.config.load import load_cell
from common.motion.convert import record_of
from forcemesh import topics
from forcemesh.requests import Empty, ForceStartRequest, MoveRequest
from tests.contract.rig import shifted
from tests.fakes.bench import DEMO
from tests.fakes.lab import Lab

CELL = load_cell(DEMO.with_name("demo-plain.yaml"))


def test_a_client_moves_presses_and_releases() -> None:
    """Goals a, b and c, then force feedback g in the controller: 15 N, then zero."""
    lab = Lab(CELL)
    arm = lab.cell.arm
    home, q = arm.T_base_flange, arm.q
    target = shifted(home, x_m=0.03, z_m=0.05)
    for goal in (
        MoveRequest(kind="pose", pose=record_of(target), speed_m_s=0.05),
        MoveRequest(kind="by", joint_rad=(0.05, 0.0, 0.0, 0.0, 0.0, 0.1), speed_m_s=0.05),
        MoveRequest(kind="joints", joint_rad=tuple(q.tolist()), speed_m_s=0.05),
    ):
        assert lab.ask(topics.MOVE, goal).accepted
        lab.cell.advance(0.5)
        lab.finish_move(20.0)
        if goal.kind == "pose":
            assert np.linalg.norm(lab.p_m() - target.translation) < 1e-3
    assert np.abs(arm.q - q).max() < 1e-3

    for setpoint_N in (15.0, 0.0):
        start = ForceStartRequest(mode="position", host="controller", setpoint_N=setpoint_N)
        assert lab.ask(topics.FORCE_START, start).accepted
        lab.cell.advance(6.0)
        assert lab.state.status.feedback == "position"
        assert arm.true_wrench().force_N[2] == pytest.approx(setpoint_N, abs=1.0)
    assert lab.ask(topics.FORCE_STOP, Empty()).accepted
    lab.cell.advance(0.5)
    assert lab.state.status.feedback is None
