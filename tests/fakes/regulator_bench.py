"""The regulator on an in-memory bus between a wrench, a robot and an arbiter."""

from typing import Any

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from forcemesh import topics
from forcemesh.bus import Origin
from forcemesh.messages import (
    ArbiterStatus,
    Message,
    RegulatorTarget,
    RobotCommand,
    WrenchAtTcp,
)
from forcemesh.requests import ForceStartRequest, Reply
from services.regulator.service import Regulator
from tests.fakes.arbiter_world import good_messages
from tests.fakes.bench import CELL, Bench
from tuning.gain_rule import tune

T_FLANGE_TCP = CELL.tool.T_flange_tcp.pose
POSITION = ForceStartRequest(mode="position")
PERIOD_S = 1.0 / CELL.rates.control_hz
KI = tune(CELL).force_i_m_per_Ns


class RegulatorBench(Bench):
    """The regulator between a wrench, a robot and an arbiter that tests may bend."""

    def __init__(self, cell: CellConfig = CELL) -> None:
        """Start armed, free of contact, with everybody alive."""
        super().__init__("regulator", Regulator, cell)
        self.wrench = WrenchAtTcp(axes_checked=True)
        self.arbiter = ArbiterStatus(state="ARMED", lease=3)
        self.robot = good_messages(CELL)["robot"]
        self.command = RobotCommand(kind="idle")
        self.silent: set[str] = set()
        self.before_step = self._speak
        self.out = self.watch(topics.REGULATOR_TARGET)

    def _speak(self) -> None:
        said: tuple[tuple[topics.Topic[Any], Message], ...] = (
            (topics.WRENCH, self.wrench),
            (topics.ARBITER_STATUS, self.arbiter),
            (topics.ROBOT_STATE, self.robot),
            (topics.ROBOT_COMMAND, self.command),
        )
        for topic, message in said:
            if topic.key not in self.silent:
                self.put(topic, message, Origin(77, 8) if topic is topics.WRENCH else None)

    def push(self, force_N=(0.0, 0.0, 0.0), torque_Nm=(0.0, 0.0, 0.0)) -> None:
        """Let the environment push from now on."""
        self.wrench = WrenchAtTcp(force_N=force_N, torque_Nm=torque_Nm, axes_checked=True)

    def start(self, wanted: ForceStartRequest = POSITION) -> Reply:
        """Ask for force feedback."""
        return self.ask(topics.FORCE_START, wanted)

    def said(self) -> RegulatorTarget:
        """Return the newest target."""
        target: RegulatorTarget = self.newest(topics.REGULATOR_TARGET)
        return target

    def T_base_tcp(self) -> pin.SE3:
        """Return the TCP that is proposed."""
        record = self.said().pose
        assert record is not None
        return pose_of(record) * T_FLANGE_TCP


def assert_stopped(bench: RegulatorBench, reason: str) -> None:
    """Not valid, no mode, no pose, and the reason."""
    said = bench.said()
    assert (said.valid, said.mode, said.pose) == (False, None, None)
    assert reason in said.reason
