"""A whole cell with protocol plain, in lock step: requests of a client, plain.as, and the arm."""

from pathlib import Path

import numpy as np
import pytest

from common.config.load import load_cell
from common.motion.convert import pose_of, record_of
from forcemesh import topics
from forcemesh.messages import RobotState
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, MoveRequest
from launch.virtual_cell import VirtualCell
from tests.contract.rig import shifted

CELL = Path(__file__).resolve().parents[2] / "cells" / "demo-plain.yaml"
PRESS_N = 15.0


class PlainWorld:
    """The cell of cells/demo-plain.yaml, armed."""

    def __init__(self) -> None:
        self.world = VirtualCell(load_cell(CELL))
        self.client = self.world.client
        self._robot = self.client.reader(topics.ROBOT_STATE)
        self.world.advance(3.0)
        self.ask(topics.TARE, Empty())
        self.world.advance(1.0)
        self.ask(topics.ARM, ArmRequest())
        self.world.advance(0.5)

    def ask(self, request, message) -> None:
        """Send a request that must be accepted."""
        reply = self.client.ask(request, message)
        assert reply.accepted, reply.text

    @property
    def state(self) -> RobotState:
        """The newest state of the robot."""
        message = self._robot.read(self.world.clock.now_ns()).message
        assert message is not None
        return message

    def move(self, **content) -> None:
        """Move, and wait for the end of the goal."""
        before = self.state.goal.id
        self.ask(topics.MOVE, MoveRequest(speed_m_s=0.05, **content))
        self.world.advance(20.0, lambda: self.state.goal.id > before)
        self.world.advance(20.0, lambda: self.state.goal.state != "running")
        assert self.state.goal.state == "done", self.state.goal.reason

    def force_N(self) -> float:
        """True force of the plate."""
        return float(self.world.arm.true_wrench().force_N[2])


def test_a_client_moves_presses_and_releases():
    """Goals a, b and c, then force feedback g in the controller: 15 N, then zero."""
    cell = PlainWorld()
    arm = cell.world.arm
    home, q = arm.T_base_flange, arm.q
    cell.move(kind="pose", pose=record_of(shifted(home, x_m=0.03, z_m=0.05)))
    assert np.linalg.norm(pose_of(cell.state).translation - home.translation) > 0.05
    cell.move(kind="by", joint_rad=(0.05, 0.0, 0.0, 0.0, 0.0, 0.1))
    cell.move(kind="joints", joint_rad=tuple(q.tolist()))
    assert np.abs(arm.q - q).max() < 1e-3

    for setpoint_N in (PRESS_N, 0.0):
        start = ForceStartRequest(mode="position", host="controller", setpoint_N=setpoint_N)
        cell.ask(topics.FORCE_START, start)
        cell.world.advance(6.0)
        assert cell.state.status.feedback == "position"
        assert cell.force_N() == pytest.approx(setpoint_N, abs=1.0)
    cell.ask(topics.FORCE_STOP, Empty())
    cell.world.advance(0.5)
    assert cell.state.status.feedback is None


def test_the_loop_on_the_pc_is_refused():
    """Its set points have no command; the reply names the host that there is."""
    cell = PlainWorld()
    start = ForceStartRequest(mode="position", host="pc", setpoint_N=5.0)
    reply = cell.client.ask(topics.FORCE_START, start)
    assert not reply.accepted
    assert "controller" in reply.text
